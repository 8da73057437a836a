"""The plain car: what drives say of it where nothing but the instruments' noise is left.

The same windows, likelihood and search as everywhere, for a car without the structure that real
ones have. What is not noise of the instruments is a discrepancy of unknown size here. A short
search over windows of one second from every start gives a rough car; where that one explains its
windows, the last stage's windows are whole blocks, in which errors of parameters grow and those of
starts fade. What is known of the car then is far more than windows of one second show.
"""

# Why: docs/decisions/identification.md#d46

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.chassis import Chassis
from steerd.car_model.model import Model
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import BLOCK
from steerd.sysid.data.windows import GROUPS, estimate_noise
from steerd.sysid.inference.augmented_car import inflate_each, make_augmented_car
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.noise import Noise, instrument_rows, signal_noise
from steerd.sysid.inference.posterior import posterior_of
from steerd.sysid.inference.predictor import HORIZON, Predictor, open_predictor
from steerd.sysid.inference.search import Point, curvature, minimise, open_point, stand, with_size
from steerd.sysid.inference.space import SPEED_LOOP, hidden_names, make_space, weak_knowledge

Array = NDArray[np.float64]

DEFAULT_FREE: tuple[str, ...] = (
    "lf", "lr", "c_sf", "c_sr", "inertia_z", "steer_gain", "steer_bias", "steer_delay",
    "steer_lag", "speed_gain", "speed_lag",
)  # fmt: skip
"""Free unless said otherwise. mu only scales the stiffnesses, mass only the inertia: fixed."""
SPEED_CHANGE = 0.1
"""A commanded speed that varies by less within every drive was never changed [m/s]."""
ENOUGH, MOST = 60.0, 240.0
"""Driving that is enough for a rough car, and for the last stage [s]."""
POOR = 2.0
"""Residuals so many times the noise say that the car is not explained, or another one is meant."""
_OUTLIER = 3.0
"""Errors beyond so many standard deviations count as that many."""


class Asked(NamedTuple):
    """What is asked of drives."""

    # The car as believed so far: weak priors lie about it, what is not free stays
    model: Model[float]
    free: tuple[str, ...]  # names of the free parameters
    wheelbase: float | None = None  # measured distance of the axles [m]


@dataclass(frozen=True, eq=False)
class PlainCar:
    """A plain car at its best on some windows."""

    start: Model[float]  # where its search began
    likelihood: Likelihood  # the windows, under the instruments' noise
    point: Point  # the car there
    noise: Noise  # of the instruments

    @property
    def predictor(self) -> Predictor:
        """The windows."""
        return self.likelihood.predictor

    @property
    def misfit(self) -> dict[str, float]:
        """Residual over the instruments' noise by group; 1 says that the car explains all."""
        return misfit_of(self.predictor, self.point.linear.error, self.noise)

    @property
    def explains(self) -> bool:
        """Whether it leaves little more than noise."""
        return max(self.misfit.values()) <= POOR


def misfit_of(predictor: Predictor, error: Array, noise: Noise) -> dict[str, float]:
    """Root mean square of errors (W, D) over the noise, by group; single outliers bounded."""
    error, found = error * np.sqrt(predictor.padded.merged), {}
    for rows, name, sigma in zip(
        instrument_rows(predictor), GROUPS, noise.instruments, strict=True
    ):
        size = np.abs(error[rows > 0.0]) / sigma
        if len(size):
            limit = _OUTLIER * max(1.0, float(np.median(size)) / 0.6745)
            found[name] = float(np.sqrt(np.mean(np.minimum(size, limit) ** 2)))
    return found


def default_free(chassis: Chassis) -> tuple[str, ...]:
    """Names of the parameters that are free unless said otherwise."""
    return (*DEFAULT_FREE, "c_x") if chassis.drive else DEFAULT_FREE


def free_of(runs: Sequence[Run], asked: Sequence[str]) -> tuple[str, ...]:
    """What of the parameters asked for can show in such drives at all.

    Raises:
        DataError: nothing of it.
    """
    gone = {*hidden_names(runs), *silent_names(runs, asked)}
    free = tuple(name for name in asked if name not in gone)
    if not free:
        hint = "drive `steerd collect --plan mixed`"
        raise DataError("the speed was never changed: nothing of it is identifiable", hint)
    return free


def silent_names(runs: Sequence[Run], asked: Sequence[str]) -> tuple[str, ...]:
    """What of the speed loop is asked for though the commanded speed never changes.

    Nothing excites it then; what a search would call its lag is what initial speeds are off by.
    """
    commanded = all(run.speed_source == "command" for run in runs)
    if not commanded or max(float(np.ptp(run.commands[:, 1])) for run in runs) > SPEED_CHANGE:
        return ()
    return tuple(name for name in asked if name in SPEED_LOOP)


def open_plain(
    runs: Sequence[Run], asked: Asked, rough: PlainCar | None, horizon: float, most: float
) -> tuple[Likelihood, Noise]:
    """Windows of `horizon` seconds under the instruments' noise, and that noise.

    Responses to a discrepancy are those of a `rough` car, or of the car as believed (None); the
    windows are evenly from the whole, `most` seconds of driving.
    """
    augmented = replace(make_augmented_car(asked.model, runs), wheelbase=asked.wheelbase)
    augmented = replace(augmented, knowledge=weak_knowledge(augmented, asked.free))
    predictor = open_predictor(augmented, runs, horizon, most, means=True)
    noise = signal_noise(estimate_noise(runs))
    about = augmented.base if rough is None else rough.point.parameters
    predictor = predictor.stepped_for(about)
    return make_likelihood(predictor, about, predictor.guess.copy(), noise), noise


def search_plain(
    runs: Sequence[Run], asked: Asked, rough: PlainCar | None = None
) -> PlainCar | None:
    """The car at its best, at last under no more discrepancy than is needed.

    From the car as believed to one good enough to begin with; from such a rough one over windows as
    long as blocks. None where the simulation diverges.

    Raises:
        ValueError: a name is unknown, the runs' grids differ, or no window sees enough poses.
    """
    extent = (HORIZON, ENOUGH) if rough is None else (BLOCK, MOST)
    likelihood, noise = open_plain(runs, asked, rough, *extent)
    space = make_space(likelihood.predictor.augmented, asked.free)
    x = likelihood.predictor.guess.copy()
    z = space.centre if rough is None else space.chart.coordinates(rough.point.parameters)
    try:
        point = minimise(likelihood, open_point(likelihood, space, z, x))
        point = minimise(likelihood, with_size(likelihood, point, 0.0))
    except (FloatingPointError, np.linalg.LinAlgError):
        return None
    return PlainCar(asked.model, likelihood, point, noise)


def covariance_of(found: PlainCar, doubts: Sequence[tuple[str, float]]) -> Array:
    """(n, n) of the coordinates, as wide as windows disagree, with what is in no log.

    Doubts about other parameters are not estimated; their effect on the coordinates is linear (the
    "consider" parameters of Schmidt, 1966). One about a free parameter stands for itself: no data
    reduce it.

    Args:
        found: the car.
        doubts: parameters that may be off whatever the drives say, and by how much.
    """
    at, space = found.point.at, found.point.space
    pulls = at.weight[:, None] * at.g
    covariance = inflate_each(posterior_of(found.point, 1.0).covariance, pulls)
    for name, sd in doubts:
        if name in space.chart.free:
            covariance[(space.chart.free.index(name),) * 2] += sd**2
    others = [(name, sd) for name, sd in doubts if name not in space.chart.free and sd > 0.0]
    if others:
        carried = _by_others(found, [name for name, _ in others]) * [sd for _, sd in others]
        covariance += carried @ carried.T
    return covariance


def _by_others(found: PlainCar, names: Sequence[str]) -> Array:
    """(n, k) how far the optimum moves per unit of other parameters."""
    likelihood, point, augmented = found.likelihood, found.point, found.predictor.augmented
    n, every = len(point.z), [*point.space.chart.free, *names]
    wide = make_space(replace(augmented, knowledge=weak_knowledge(augmented, every)), every)
    z = wide.chart.coordinates(point.parameters)
    at = stand(likelihood, wide, z, point.x, point.size).at
    h = curvature(wide, at) - wide.precision
    return np.asarray(np.linalg.solve(h[:n, :n] + point.space.precision, h[:n, n:]))
