"""Limits that the VESC itself holds during a session, whatever the host does.

They live in the VESC's RAM: SET_MCCONF_TEMP without ``store``, read back with GET_MCCONF_TEMP,
restored at the end and gone after a power cycle (`docs/reference/vesc-serial.md#v3.9`).
"""

import math

from steerd.vesc_link.commands import SetMcConfTemp
from steerd.vesc_link.identity import LIMIT_FIELDS, McConfTemp

_F32_EPSILON = 1e-6


def make_session_limits(
    in_force: McConfTemp, erpm_max: float, current_scale: float = 1.0, duty_max: float = 0.95
) -> SetMcConfTemp:
    """Limits for a session: tighter than those in force or equal, never wider.

    Args:
        in_force: limits read before.
        erpm_max: largest ERPM in either direction.
        current_scale: share of the configured drive current, 0 to 1; braking keeps its share.
        duty_max: largest duty cycle.

    Raises:
        ValueError: a limit is not positive and finite, so the car could not move.
    """
    if not all(math.isfinite(x) and x > 0 for x in (erpm_max, current_scale, duty_max)):
        raise ValueError("session limits must be positive and finite")
    return SetMcConfTemp(
        current_min_scale=in_force.current_min_scale,
        current_max_scale=min(in_force.current_max_scale, current_scale),
        erpm_min=max(in_force.erpm_min, -erpm_max),
        erpm_max=min(in_force.erpm_max, erpm_max),
        duty_min=in_force.duty_min,
        duty_max=min(in_force.duty_max, duty_max),
        watt_min=in_force.watt_min,
        watt_max=in_force.watt_max,
        input_current_min=in_force.input_current_min,
        input_current_max=in_force.input_current_max,
    )


def make_restored_limits(before: McConfTemp) -> SetMcConfTemp:
    """The limits that were in force before the session."""
    return SetMcConfTemp(**{field.name: getattr(before, field.name) for field in LIMIT_FIELDS})


def limits_hold(requested: SetMcConfTemp, read_back: McConfTemp) -> bool:
    """Whether the limits read back are the ones set, within single precision."""
    return all(
        math.isclose(
            getattr(requested, field.name), getattr(read_back, field.name), rel_tol=_F32_EPSILON
        )
        for field in LIMIT_FIELDS
    )
