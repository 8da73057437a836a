"""What the learner knows, as a message of the bus."""

from dataclasses import fields
from math import nan

from steerd.daemon.learning.reported import NS, ReportedChange, ReportedValue, pack
from steerd.sim_gap.online.learner import Change, State
from steerd.sim_gap.online.tracking import Remembered
from steerd.sim_gap.online.values import Value, amounts_of, unit_of, values_of
from steerd.steer_bus import messages as m

NONE_NS = -1
_SD = "_sd"
_LEARNT = tuple(
    field.name.removesuffix(_SD) for field in fields(m.Model) if field.name.endswith(_SD)
)
"""The car's numbers that the message has fields for."""


def verdict_of(state: State) -> str:
    """`learning`, `none`, or the newest change's."""
    if state.known is None:
        return "learning"
    changes = changes_of(state)
    return changes[-1].finding.verdict if changes else "none"


def changes_of(state: State) -> tuple[Change, ...]:
    """All changes so far, oldest first."""
    return (*state.past, state.change) if state.change is not None else state.past


def make_model(
    state: State, mono_ns: int, epoch_ns: int, dropped: int, remembered: tuple[Remembered, ...] = ()
) -> m.Model:
    """The report of a state.

    Args:
        state: of the learner.
        mono_ns: of the newest pose [ns, monotonic].
        epoch_ns: UNIX time minus monotonic time [ns].
        dropped: records that were lost so far.
        remembered: what an earlier drive taught: reported until this one knows the car.
    """
    early = (Value(*each, unit_of(each.name), True) for each in remembered)
    values = values_of(state.known) if state.known else tuple(early)
    by_name = {value.name: value for value in values}
    changes = [_reported_change(change) for change in changes_of(state)]
    newest = changes[-1] if changes else None
    numbers = {
        key: number
        for name in _LEARNT
        for key, number in zip((name, name + _SD), _number(by_name.get(name)), strict=True)
    }
    return m.Model(
        header=m.make_header(mono_ns + epoch_ns, m.BODY),
        mono_ns=mono_ns,
        since_ns=newest.since_ns if newest else NONE_NS,
        noticed_ns=newest.noticed_ns if newest else NONE_NS,
        windows=state.seen,
        dropped=dropped,
        confidence=newest.confidence if newest else nan,
        **numbers,
        verdict=verdict_of(state),
        effect=newest.effect if newest else "",
        alternatives=",".join(newest.alternatives) if newest else "",
        identifiable=",".join(value.name for value in values if value.identifiable),
        details=pack([ReportedValue(*value) for value in values], changes),
    )


def _number(value: Value | None) -> tuple[float, float]:
    return (nan, nan) if value is None else (value.value, value.sd)


def _reported_change(change: Change) -> ReportedChange:
    finding, cause = change.finding, change.finding.cause
    since, noticed = round(change.since * NS), round(change.noticed * NS)
    if cause is None:
        return ReportedChange(since, noticed, finding.verdict, "", nan, (), ())
    reported = tuple(ReportedValue(name, *amount) for name, amount in amounts_of(change).items())
    return ReportedChange(
        since,
        noticed,
        finding.verdict,
        cause.effect,
        cause.confidence,
        cause.ambiguous_with,
        reported,
    )
