"""Which numbers a hypothesis may change: the base's own within their uncertainty, and the effect's.

The base's parameters are nuisance: an effect is named only for what no believable base explains.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from steerd.car_model.effect import Channel
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import AugmentedCar, BasePrior
from steerd.sysid.inference.chart import (
    LENGTHS,
    RELATIVE,
    Chart,
    effect_scales,
    make_chart,
    relative_length,
)

WIDER = 2.0  # prior standard deviation of a base parameter per standard error of its identification
BOX = 3.0  # base parameters stay within this many prior standard deviations
EFFECT_WIDER = 3.0  # prior standard deviation of an effect's parameter per its scale: barely one
FLOORS = {
    "lf": 0.002, "lr": 0.002, "c_sf": 0.02, "c_sr": 0.02, "c_x": 0.1, "inertia_z": 0.03,
    "steer_gain": 0.004, "steer_bias": 5e-4, "steer_delay": 1e-3, "steer_lag": 2e-3,
    "steer_rate": 0.02, "speed_gain": 0.002, "speed_lag": 4e-3, "drive_delay": 2e-3,
    "accel_max": 0.1, "decel_max": 0.1, "pose_delay": 5e-4,
}  # fmt: skip
"""Least prior standard deviation: what an identified car is off by because every model is wrong.
Relative for stiffnesses, inertia and gains, for lengths of a car of the default's size, else in the
parameter's unit."""
LIMITS = ("steer_rate", "accel_max", "decel_max")
"""Limits, which a data sheet gives for another car; drives that reach them identify this one's."""
SPEED_LOOP = ("speed_lag", "drive_delay", "accel_max", "decel_max")
"""What lies between a commanded speed and the wheels'."""
SESSION = 0.3  # of the floors, what a car differs by from one day to the next beside that
UNKNOWN = 3.0  # how much wider the floors are where the car file gives no standard error


@dataclass(frozen=True, eq=False)
class Space:
    """Coordinates of a hypothesis."""

    chart: Chart  # between coordinates and parameters
    centre: Array  # (n,) where the prior lies; the base at its effects' nulls
    covariance: Array  # (n, n) of the prior: the base's own coordinates move together
    precision: Array  # (n, n) its inverse, as often as it counts (see `heavier`)
    low: Array  # (n,) physical bounds
    high: Array  # (n,)
    effects: tuple[str, ...]  # names of the hypothesis' effects, none for the base alone
    nuisance: int  # how many of the coordinates are the base's; they come first

    def heavier(self, times: float) -> "Space":
        """The same with a prior that counts so often, as windows of which so many are worth one.

        Costs then are as many times those of the tempered posterior, whose optimum is the same.
        """
        return replace(self, precision=times * self.precision)

    @property
    def spread(self) -> Array:
        """(n,) prior standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def inside(self) -> Array:
        """(n,) the prior's centre, half a deviation off the bounds where it lies at one.

        What an effect does may begin with its square: at the bound no slope leads away from it.
        """
        room = np.minimum(0.5 * self.spread, 0.5 * (self.high - self.low))
        return np.clip(self.centre, self.low + room, self.high - room)

    def prior_cost(self, z: Array) -> float:
        """Negative log of the prior's density, but for a constant [nats]."""
        away = z - self.centre
        return 0.5 * float(away @ self.precision @ away)

    def prior_pull(self, z: Array) -> Array:
        """(n,) slope of the log prior."""
        return np.asarray(self.precision @ (self.centre - z))

    def base_cost(self, z: Array) -> float:
        """What the base's coordinates alone cost under their own prior [nats]."""
        own = slice(0, self.nuisance)
        away = (z - self.centre)[own]
        return 0.5 * float(away @ np.linalg.solve(self.covariance[own, own], away))


def _commanded(runs: Sequence[Run]) -> bool:
    return all(run.speed_source == "command" for run in runs)


def hidden_names(runs: Sequence[Run]) -> set[str]:
    """Base parameters that such drives cannot show where their measured speed is prescribed.

    Nothing of the speed loop then; nor of the wheels, where it is the body's speed.
    """
    if _commanded(runs):
        return set()
    rolled = any(run.speed_source == "wheel" for run in runs)
    return {*SPEED_LOOP, *(() if rolled else ("speed_gain", "c_x"))}


def nuisance_names(augmented: AugmentedCar, runs: Sequence[Run]) -> tuple[str, ...]:
    """Base parameters that are free in every hypothesis: those that identification frees."""
    known, gone = augmented.knowledge, hidden_names(runs)
    gone |= set() if augmented.kernels.chassis.drive else {"c_x"}
    names = list(FLOORS)
    if known is not None:
        names = [name for name in known.names if "." in name or name in FLOORS]
    elif augmented.sd:  # an identification from before they were free
        gone |= {*LIMITS, *({"drive_delay"} - augmented.sd.keys())}
    if known is not None and not _commanded(runs):
        held = {e.name for e in augmented.effects if e.follows_acceleration}
        gone |= {name for name in names if name.partition(".")[0] in held}
    return tuple(name for name in names if name not in gone)


def informative_effects(augmented: AugmentedCar, runs: Sequence[Run]) -> tuple[str, ...]:
    """Effects that such drives can show: where the measured speed is prescribed, none of the drive.

    What the motor does is then no prediction, a limit on it would only hold the car back from the
    speed that was measured, and that speed's acceleration is mostly noise.
    """
    commanded = _commanded(runs)
    missing = set() if commanded else {Channel.SPEED}
    chassis = augmented.kernels.chassis.name
    built_in = {e.name for e in augmented.effects if chassis in e.built_into}
    return tuple(
        e.name for e in augmented.effects
        if e.needs_commands not in missing and e.name not in built_in
        and (commanded or not e.follows_acceleration)
    )  # fmt: skip


def make_space(
    augmented: AugmentedCar, nuisance: Sequence[str], effects: Sequence[str] = ()
) -> Space:
    """Coordinates for some effects beside the base's own parameters.

    An effect that the base has itself (`effect.parameter` among `nuisance`) is freed about the
    base's value, its prior as wide as any effect's.

    Raises:
        ValueError: a name is unknown.
    """
    names = augmented.kernels.names
    own = [names[i] for effect in effects for i in augmented.places(effect)]
    base = [name for name in nuisance if name not in own]
    chart = make_chart(augmented.effects, augmented.base, [*base, *own], augmented.wheelbase)
    base = [name for name in base if name in chart.free]
    centre = chart.coordinates(augmented.base)
    low, high = chart.bounds()
    covariance = _base_covariance(augmented, chart, len(base))
    if augmented.knowledge is None:
        spread = BOX * np.sqrt(np.diag(covariance))[: len(base)]
        low[: len(base)] = np.maximum(low[: len(base)], (centre[: len(base)] - spread))
        high[: len(base)] = np.minimum(high[: len(base)], (centre[: len(base)] + spread))
    else:
        for i, name in enumerate(base):
            low[i] = max(low[i], min(augmented.knowledge.least.get(name, -np.inf), centre[i]))
    width = range(len(base), len(centre))
    covariance[width, width] += (EFFECT_WIDER * chart.spread[len(base) :]) ** 2
    precision = np.asarray(np.linalg.inv(covariance))
    centre = np.clip(centre, low, high)
    return Space(chart, centre, covariance, precision, low, high, tuple(effects), len(base))


def weak_knowledge(
    augmented: AugmentedCar,
    names: Sequence[str],
    shares: Mapping[str, float] = MappingProxyType({}),
) -> BasePrior:
    """Knowing next to nothing: wide spreads of cars, or a share of them by parameter."""
    chart = make_chart(augmented.effects, augmented.base, names, augmented.wheelbase)
    wide = c.WEAK * np.array([shares.get(name, 1.0) for name in chart.free]) * chart.spread
    return BasePrior(chart.free, np.diag(np.square(wide)))


def _base_covariance(augmented: AugmentedCar, chart: Chart, nuisance: int) -> Array:
    """(n, n) covariance of what the base knows; zero for what it does not have."""
    free, known = chart.free, augmented.knowledge
    slopes = np.abs(chart.own_slopes(chart.coordinates(augmented.base)))
    held = [] if known is None else [i for i, name in enumerate(free) if name in known.names]
    covariance = np.zeros((len(free),) * 2)
    if known is not None:
        covariance[np.ix_(held, held)] = known.part([free[i] for i in held])
    for i, name in enumerate(free[:nuisance]):
        least = least_sd(augmented, name)
        sd = SESSION * least if i in held else _spread(augmented, name, least)
        covariance[i, i] += (sd / slopes[i]) ** 2
    return covariance


def least_sd(augmented: AugmentedCar, name: str) -> float:
    """A base parameter's least standard deviation, in its own unit: what differs between days."""
    if name not in FLOORS:
        return 0.05 * effect_scales(augmented.effects).get(name, 0.0)
    names = augmented.kernels.names
    if name in LENGTHS:
        return FLOORS[name] * relative_length(names, augmented.base)
    value = abs(float(augmented.base[names.index(name)]))
    return FLOORS[name] * (value if name in RELATIVE else 1.0)


def _spread(augmented: AugmentedCar, name: str, least: float) -> float:
    """Prior standard deviation of a base parameter of which nothing was learnt with others."""
    if name not in FLOORS:
        return least / 0.05
    if not augmented.sd:
        return UNKNOWN * least
    return max(least, WIDER * min(augmented.sd.get(name, 0.0), 20.0 * least))
