"""What can be wrong, by the blind test's names and sizes, in the terms of these plants.

Names, units, severities and labels are those of `blind_gap.effects`; what is done to a plant is
said here for wiring (plants b and c) and beside each plant's builder for the rest.
"""

from collections.abc import Callable, Mapping

from benchmarks.blind_gap.effects import EFFECTS, OUTSIDE, SIZES, Place, Values
from benchmarks.foreign_cars.wiring import Wiring

Rewire = Callable[[Wiring, Values], Wiring]


class UnknownEffectError(ValueError):
    """An effect or a defect that the plant does not have."""


def _more(attribute: str, parameter: str) -> Rewire:
    return lambda w, v: w._replace(**{attribute: getattr(w, attribute) + v[parameter]})


def _scaled(attribute: str, parameter: str) -> Rewire:
    return lambda w, v: w._replace(**{attribute: getattr(w, attribute) * v[parameter]})


def _capped(parameter: str, *attributes: str) -> Rewire:
    return lambda w, v: w._replace(**{a: min(getattr(w, a), v[parameter]) for a in attributes})


WIRED: Mapping[str, Rewire] = {
    "steer_delay": _more("steer_delay", "delay"),
    "steer_lag": _more("steer_lag", "lag"),
    "steer_rate_limit": _capped("rate", "steer_rate"),
    "steer_bias": _more("steer_bias", "bias"),
    "steer_gain": _scaled("steer_gain", "gain"),
    "steer_nonlinearity": _more("steer_cubic", "cubic"),
    "steer_asymmetry": _more("steer_asymmetry", "asymmetry"),
    "steer_clip": _capped("limit", "steer_left", "steer_right"),
    "steer_backlash": _more("steer_play", "play"),
    "drive_delay": _more("drive_delay", "delay"),
    "drive_lag": _more("drive_lag", "lag"),
    "accel_limit": _capped("limit", "accel_max", "brake_max"),
    "speed_scale": _scaled("speed_gain", "scale"),
    "battery_sag": _more("sag_rate", "rate"),
    "mocap_latency": _more("pose_delay", "latency"),
    "mocap_yaw": _more("marker_yaw", "offset"),
    "marker_offset": lambda w, v: w._replace(
        marker_x=w.marker_x + v["forward"], marker_y=w.marker_y + v["left"]
    ),
}
"""Effects of actuators and sensors."""
WIRED_OUTSIDE: Mapping[str, str] = {
    "servo_freeze": "freeze",
    "drive_dropout": "cut",
    "stamp_jitter": "stamp_jitter",
    "quantised_commands": "steer_grid",
    "mocap_swim": "swim",
}
"""Defects of actuators and sensors that no effect describes, and the wiring's number of each."""
_OWN_OUTSIDE = {"left_right_tyres": (0.05, 0.12, 0.25), "loose_knuckle": (0.03, 0.06, 0.12)}
"""Defects that the blind test does not have: relative grip; play of one knuckle [rad]."""


PATCH_RADIUS = 2.0
"""Of a slippery patch [m]: these drives wander over 30 m and would rarely cross a small one."""


def strength_of(name: str, size: str) -> float:
    """Strength of an effect or defect of a size (`small`, `medium`, `large`).

    Raises:
        UnknownEffectError: nothing has that name, or it has no such size.
    """
    kind = EFFECTS.get(name) or OUTSIDE.get(name)
    table = kind.table if kind else _OWN_OUTSIDE.get(name)
    if table is None or size not in SIZES:
        raise UnknownEffectError(f"{name}, {size}: no such effect or size")
    return table[SIZES.index(size)]


def label_of(name: str, size: str, place: Place) -> Values:
    """The contract's parameters of an effect; of a defect its strength."""
    strength = strength_of(name, size)
    effect = EFFECTS.get(name)
    if effect is None:
        return {"strength": strength}
    values = effect.values(strength, place)
    return values | {"radius": PATCH_RADIUS} if name == "grip_patch" else values
