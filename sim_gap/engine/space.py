"""Which numbers a hypothesis may change: the base's own within their uncertainty, and the effect's.

The base's parameters are nuisance: an effect is named only for what no believable base explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import Channel
from steerd.sim_gap.engine.superset import Superset
from steerd.sysid.data.dataset import Run
from steerd.sysid.estimation.chart import INVERSE, LOGARITHM, RELATIVE, Chart, make_chart

Array = NDArray[np.float64]

WIDER = 2.0
"""Prior standard deviation of a base parameter per standard error of its identification."""
BOX = 3.0
"""Base parameters stay within this many prior standard deviations."""
EFFECT_WIDER = 3.0
"""Prior standard deviation of an effect's parameter per its scale: hardly a prior at all."""
FLOORS = {
    "lf": 0.002, "lr": 0.002, "c_sf": 0.02, "c_sr": 0.02, "c_x": 0.1,
    "inertia_z": 0.03, "steer_gain": 0.004, "steer_bias": 5e-4, "steer_delay": 1e-3, "steer_lag": 2e-3, "speed_gain": 0.002,
    "speed_lag": 4e-3, "drive_delay": 2e-3, "pose_delay": 5e-4,
}  # fmt: skip
"""Least prior standard deviation: what an identified car is off by because every model is wrong.

Relative for stiffnesses, inertia and gains, else in the parameter's unit.
"""
UNKNOWN = 3.0
"""How much wider the floors are where the car file gives no standard error."""


@dataclass(frozen=True, eq=False)
class Space:
    """Coordinates of a hypothesis.

    Attributes:
        chart: between coordinates and parameters.
        centre: (n,) where the prior lies; the base at its effects' nulls.
        spread: (n,) prior standard deviations.
        low: (n,) bounds.
        high: (n,).
        effects: names of the hypothesis' effects, none for the base alone.
        nuisance: how many of the coordinates are the base's; they come first.
    """

    chart: Chart
    centre: Array
    spread: Array
    low: Array
    high: Array
    effects: tuple[str, ...]
    nuisance: int


def nuisance_names(superset: Superset, runs: Sequence[Run]) -> tuple[str, ...]:
    """Base parameters that are free in every hypothesis: those that identification frees."""
    slipping = bool(superset.kernels.chassis.drive)
    names = [name for name in FLOORS if name != "c_x" or slipping]
    sources = {run.speed_source for run in runs}
    if sources != {"command"}:
        gone = {"speed_lag", "drive_delay"} | ({"speed_gain"} if "wheel" not in sources else set())
        names = [name for name in names if name not in gone]
    if superset.sd and "drive_delay" in names and "drive_delay" not in superset.sd:
        names.remove("drive_delay")
    return tuple(names)


def telling_effects(superset: Superset, runs: Sequence[Run]) -> tuple[str, ...]:
    """Effects that such drives can show: where the measured speed is prescribed, none of the drive.

    What the motor does is then no prediction, a limit on it would only hold the car back from the
    speed that was measured, and that speed's acceleration is mostly noise.
    """
    missing = set() if all(run.speed_source == "command" for run in runs) else {Channel.SPEED}
    chassis = superset.kernels.chassis.name
    built_in = {e.name for e in superset.effects if chassis in e.built_into}
    return tuple(
        e.name
        for e in superset.effects
        if e.needs_commands not in missing and e.name not in built_in
    )


def _spread(superset: Superset, name: str) -> float:
    """Prior standard deviation of a base parameter in its own unit."""
    value = float(superset.base[superset.kernels.names.index(name)])
    floor = FLOORS[name]
    if name in RELATIVE:
        floor *= abs(value)
    if not superset.sd:
        return UNKNOWN * floor
    return max(floor, WIDER * min(superset.sd.get(name, 0.0), 20.0 * floor))


def make_space(superset: Superset, nuisance: Sequence[str], effects: Sequence[str] = ()) -> Space:
    """Coordinates for some effects beside the base's own parameters.

    Raises:
        ValueError: a name is unknown.
    """
    names = superset.kernels.names
    own = [names[i] for effect in effects for i in superset.places(effect)]
    chart = make_chart(superset.effects, superset.base, [*nuisance, *own])
    centre = chart.coordinates(superset.base)
    spread = np.empty(len(centre))
    low, high = (bound.copy() for bound in chart.bounds())
    for i, name in enumerate(chart.free):
        if i >= len(nuisance):
            spread[i] = EFFECT_WIDER * chart.spread[i]
            continue
        value = float(superset.base[names.index(name)])
        spread[i] = _spread(superset, name)
        if name in INVERSE:
            spread[i] /= value * value
        elif name in LOGARITHM:
            spread[i] /= value
        low[i] = max(low[i], centre[i] - BOX * spread[i])
        high[i] = min(high[i], centre[i] + BOX * spread[i])
    centre = np.clip(centre, low, high)
    return Space(chart, centre, spread, low, high, tuple(effects), len(nuisance))
