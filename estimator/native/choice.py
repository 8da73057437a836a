"""Whether the filter runs in machine code: where it gives the bits that Python gives."""

import ctypes
import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Kalman
from steerd.estimator.motion import SIZE
from steerd.estimator.native.build import library_path
from steerd.estimator.native.kernel import WIDEST, Kernel, pack_sensor, read_belief
from steerd.estimator.native.library import load_library
from steerd.estimator.sensors import Kind, Sensor, make_sensors, residual

_CHECKS = 20
_FUNCTIONS = (math.sin, math.cos, math.tan, math.atan, math.exp)
"""What the equations call, in the order of `try_functions`."""


def make_kernel(
    car: Car[float], config: FilterConfig, sensors: Mapping[Kind, Sensor]
) -> Kernel | None:
    """The machine code for a car; None where there is none, or it does not give Python's bits."""
    library = _checked_library()
    return Kernel(library, car, config, sensors) if library is not None else None


@cache
def _checked_library() -> ctypes.CDLL | None:
    try:
        library = load_library(library_path())
        return library if gives_same_bits(library) else None
    except (OSError, AttributeError, KeyError):
        return None


def gives_same_bits(library: Any) -> bool:
    """Whether algebra and elementary functions agree with Python's to the last bit.

    BLAS chooses by processor how it sums, NumPy and SciPy may bring one each, and Python may have
    been built with a C library of its own.
    """
    rng = np.random.default_rng(0)
    sensors = make_sensors(DEFAULT_CAR._replace(speed_gain=1.07), FilterConfig())
    angles = rng.uniform(-3.0, 3.0, _CHECKS).tolist()
    return all(_same_functions(library, a) for a in angles) and all(
        _same_algebra(library, rng, sensors[kind]) for _ in range(_CHECKS) for kind in Kind
    )


def _same_functions(library: Any, a: float) -> bool:
    out = (ctypes.c_double * len(_FUNCTIONS))()
    library.try_functions(ctypes.c_double(a), out)
    return list(out) == [function(a) for function in _FUNCTIONS]


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
