"""The filter's machine code behind plain values: beliefs, measurements and commands in and out."""

import ctypes
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from struct import Struct
from typing import NamedTuple

import numpy as np

from steerd.car_model.params import Car
from steerd.estimator.actuation import History, dead_times
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Array, Belief, Fused
from steerd.estimator.motion import SIZE, noise_density
from steerd.estimator.sensors import Kind, Measurement, Sensor

WIDEST = 3
"""Most values of a measurement."""
_BELIEF = SIZE + SIZE * SIZE
_NODE = _BELIEF + WIDEST + 2
_MOST_NODES = 256
_NO_COMMAND = (0.0, 0.0, 0.0)
_PADDING = ((), (0.0, 0.0), (0.0,), ())


class Prediction(NamedTuple):
    """A belief at an instant."""

    belief: Belief
    factored: bool
    """Its covariance has a Cholesky factor."""


class Kernel:
    """The machine code for one car; None from a method: ask Python, a number is not finite."""

    def __init__(
        self,
        library: ctypes.PyDLL,
        car: Car[float],
        config: FilterConfig,
        sensors: Mapping[Kind, Sensor],
    ) -> None:
        self._setup = _pack_setup(car, config, sensors)
        self._dead_time = max(dead_times(car))
        self._out = np.empty((_MOST_NODES, _NODE))
        self._where = ctypes.c_void_p(self._out.ctypes.data)
        self._fuse: Callable[..., int] = library.fuse
        self._predict: Callable[..., int] = library.predict

    def __deepcopy__(self, memo: dict[int, object]) -> "Kernel":
        """Itself, where a whole loop is copied: it remembers nothing from one call to the next."""
        return self

    def fuse(
        self, history: History, first: Belief, start_ns: int, chain: Sequence[Measurement]
    ) -> list[tuple[Fused, bool]] | None:
        """What each measurement of a chain leaves, and whether it was believed."""
        count = len(chain)
        if count > _MOST_NODES:
            return None
        numbers: list[float] = []
        for _, _, values in chain:
            numbers += (*values, *_PADDING[len(values)])
        integers = _integers(count)
        stamps = integers.pack(*[m.t_ns for m in chain])
        kinds = integers.pack(*[m.kind for m in chain])
        measured = _numbers(WIDEST * count).pack(*numbers)
        past = self._past(history, start_ns)
        root = _bytes(first)
        at = ctypes.c_int64(start_ns)
        failed = self._fuse(
            self._setup,
            *past,
            root,
            at,
            ctypes.c_int64(count),
            stamps,
            kinds,
            measured,
            self._where,
        )
        if failed:
            return None
        rows = self._out[:count].copy()
        return [_fused(row, len(m.values)) for row, m in zip(rows, chain, strict=True)]

    def predict(
        self, history: History, first: Belief, start_ns: int, stop_ns: int
    ) -> Prediction | None:
        """The belief at `stop_ns`, from the one of `start_ns`."""
        past = self._past(history, start_ns)
        begin, end = ctypes.c_int64(start_ns), ctypes.c_int64(stop_ns)
        if self._predict(self._setup, *past, _bytes(first), begin, end, self._where):
            return None
        row = self._out[0, : _BELIEF + 1].copy()
        return Prediction(read_belief(row), bool(row[_BELIEF]))

    def _past(self, history: History, start_ns: int) -> tuple[ctypes.c_int64, bytes, bytes]:
        """The commands that can act after an instant: number, times, orders."""
        first = max(bisect_right(history.times, start_ns - self._dead_time) - 1, 0)
        times = history.times[first:]
        orders: list[float] = []
        for command in history.commands[first:]:
            orders += _NO_COMMAND if command is None else (1.0, command.steer, command.speed)
        count = len(times)
        return (
            ctypes.c_int64(count),
            _integers(count).pack(*times),
            _numbers(3 * count).pack(*orders),
        )


def pack_sensor(sensor: Sensor) -> bytes:
    """As `sensor_t` has it; each reading is one state times a common gain."""
    _, states = np.nonzero(sensor.matrix)
    width = sensor.matrix.shape[0]
    gain = float(sensor.matrix[0, states[0]])
    padding = (0.0,) * (WIDEST - width)
    yaw = -1.0 if sensor.yaw_row is None else float(sensor.yaw_row)
    variances = np.diagonal(sensor.noise).tolist()
    numbers = (width, *states, *padding, gain, *variances, *padding, sensor.gate, yaw)
    return _numbers(len(numbers)).pack(*numbers)


def _pack_setup(car: Car[float], config: FilterConfig, sensors: Mapping[Kind, Sensor]) -> bytes:
    """As `setup_t` has it."""
    numbers = [*car, *noise_density(config, 1.0), config.lateral_accel_density]
    numbers += map(float, dead_times(car))
    return _numbers(len(numbers)).pack(*numbers) + b"".join(pack_sensor(sensors[k]) for k in Kind)


@lru_cache(maxsize=1024)
def _numbers(count: int) -> Struct:
    return Struct(f"={count}d")


@lru_cache(maxsize=1024)
def _integers(count: int) -> Struct:
    return Struct(f"={count}q")


def _bytes(belief: Belief) -> bytes:
    return belief.mean.tobytes() + belief.covariance.tobytes()


def read_belief(row: Array) -> Belief:
    """A belief that lies in a row: mean, then covariance by rows."""
    return Belief(row[:SIZE], row[SIZE:_BELIEF].reshape(SIZE, SIZE))


def _fused(row: Array, width: int) -> tuple[Fused, bool]:
    nis, believed = row[_BELIEF + WIDEST :].tolist()
    return Fused(read_belief(row), row[_BELIEF : _BELIEF + width], nis), bool(believed)
