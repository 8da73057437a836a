"""Whether the filter runs in machine code: where it gives the bits that Python gives."""

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from steerd.car_model.chassis import Chassis
from steerd.car_model.machine_code import load_library
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Kalman
from steerd.estimator.motion import SIZE
from steerd.estimator.native.kernel import WIDEST, Kernel, pack_sensor, read_belief
from steerd.estimator.native.library import attach
from steerd.estimator.native.source import FILTER
from steerd.estimator.sensors import Kind, Sensor, make_sensors, residual

_CHECKS = 5


def make_kernel(
    car: Car[float], chassis: Chassis, config: FilterConfig, sensors: Mapping[Kind, Sensor]
) -> Kernel | None:
    """The machine code for a car; None where there is none, or it does not give Python's bits."""
    library = _checked_library()
    return Kernel(library, car, chassis, config, sensors) if library is not None else None


@cache
def _checked_library() -> ctypes.PyDLL | None:
    return load_library(FILTER, gives_same_bits)


def gives_same_bits(library: Any) -> bool:
    """Whether its algebra agrees with Python's to the last bit.

    BLAS chooses by processor how it sums, and NumPy and SciPy may bring one each.
    """
    attach(library)
    rng = np.random.default_rng(0)
    sensors = make_sensors(DEFAULT_CAR._replace(speed_gain=1.07), FilterConfig())
    return all(_same_algebra(library, rng, sensors[kind]) for _ in range(_CHECKS) for kind in Kind)


def _same_algebra(library: Any, rng: np.random.Generator, sensor: Sensor) -> bool:
    """A prediction and an update of a random belief."""
    root, F, noise = (rng.standard_normal((SIZE, SIZE)) for _ in range(3))
    mean, Q = rng.standard_normal(SIZE), noise @ noise.T
    width = sensor.matrix.shape[0]
    measured = np.zeros(WIDEST)
    measured[:width] = rng.standard_normal(width)
    belief = np.concatenate([mean, (root @ root.T).ravel()])
    kalman = Kalman(SIZE)
    prior = kalman.predict(read_belief(belief), mean, F, Q)
    known = kalman.update(
        prior, measured[:width], sensor.matrix, sensor.noise, lambda z, hx: residual(sensor, z, hx)
    )
    y, nis = np.zeros(WIDEST), np.zeros(1)
    arrays = (belief, np.ascontiguousarray(F), Q, measured, y, nis)
    where = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
    if library.try_algebra(pack_sensor(sensor), *where):
        return False
    return (
        np.array_equal(read_belief(belief).mean, known.belief.mean)
        and np.array_equal(read_belief(belief).covariance, known.belief.covariance)
        and np.array_equal(y[:width], known.innovation)
        and float(nis[0]) == known.nis
    )
