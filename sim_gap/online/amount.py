"""By how much a named change moved the car: what the car was learnt to have before is taken off.

A base may have the effect already, and a lane may not say of it where it lies: a marker's place
and the centre of gravity move along one valley. How far either moved is known far better.
"""

from steerd.car_model.effect import Role
from steerd.car_model.effects import find_effect
from steerd.sim_gap.online.learner import Change

Amount = tuple[float, float, str]


def amounts_of(change: Change) -> dict[str, Amount]:
    """What the named effect's parameters moved by: (value, standard error, unit) by name.

    Offsets are differences and ratios quotients, to what was before. What says of which form or
    where an effect is, has no amount: it is as it is after the change. Empty without a name.
    """
    cause = change.finding.cause
    if cause is None:
        return {}
    known = find_effect(cause.effect).parameters
    return {
        p.name: _amount(cause.parameters[p.name], before, p.null) if p.role is Role.SIZE else after
        for p, before in zip(known, change.was, strict=True)
        for after in [cause.parameters[p.name]]
    }


def _amount(after: Amount, before: float, null: float) -> Amount:
    value, sd, unit = after
    if is_ratio(null, before):
        return value / before, sd / before, unit
    return value - before, sd, unit


def is_ratio(null: float, before: float) -> bool:
    """Whether a parameter scales what the car has; its null is then one."""
    return null == 1.0 and before > 0.0
