"""What the learner knows, as a message of the bus."""

from dataclasses import fields
from math import nan

from steerd.daemon.learning.reported import NS, ReportedChange, ReportedValue, pack
from steerd.sim_gap.online.learner import Change, State
from steerd.sim_gap.online.tracking import Remembered
from steerd.sim_gap.online.values import Value, amounts_of, unit_of, values_of
from steerd.steer_bus import messages as m

_SD = "_sd"
_LEARNT = tuple(
    field.name.removesuffix(_SD) for field in fields(m.Model) if field.name.endswith(_SD)
)
"""The car's numbers that the message has fields for."""


def make_model(
    state: State, mono_ns: int, epoch_ns: int, dropped: int, remembered: Remembered
) -> m.Model:
    """The report of a state.

    Args:
        state: of the learner.
        mono_ns: of the newest pose [ns, monotonic].
        epoch_ns: UNIX time minus monotonic time [ns].
        dropped: records that were lost so far.
        remembered: what an earlier drive taught: reported until this one knows the car.
    """
    early = (Value(name, *each, unit_of(name), True) for name, each in remembered.items())
    values = values_of(state.known) if state.known else tuple(early)
    by_name = {value.name: value for value in values}
    current = () if state.change is None else (state.change,)
    changes = [_reported_change(change) for change in (*state.past, *current)]
    newest = changes[-1] if changes else None
    verdict = newest.verdict if newest else "none"
    numbers: dict[str, float] = {}
    for name in _LEARNT:
        value = by_name.get(name)
        numbers |= {name: value.value if value else nan, name + _SD: value.sd if value else nan}
    return m.Model(
        header=m.make_header(mono_ns + epoch_ns, m.BODY),
        mono_ns=mono_ns,
        since_ns=newest.since_ns if newest else -1,
        noticed_ns=newest.noticed_ns if newest else -1,
        windows=state.seen,
        dropped=dropped,
        confidence=newest.confidence if newest else nan,
        **numbers,
        verdict="learning" if state.known is None else verdict,
        effect=newest.effect if newest else "",
        alternatives=",".join(newest.alternatives) if newest else "",
        identifiable=",".join(value.name for value in values if value.identifiable),
        details=pack(values, changes),
    )


def _reported_change(change: Change) -> ReportedChange:
    verdict, cause = change.finding.verdict, change.finding.cause
    since, noticed = round(change.since * NS), round(change.noticed * NS)
    if cause is None:
        return ReportedChange(since, noticed, verdict, "", nan, (), ())
    moved = tuple(ReportedValue(name, *amount) for name, amount in amounts_of(change).items())
    named = cause.effect, cause.confidence, cause.ambiguous_with
    return ReportedChange(since, noticed, verdict, *named, moved)
