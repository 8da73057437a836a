"""The filter's machine code behind plain values: beliefs, measurements and commands in and out."""

import ctypes
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import nan
from struct import Struct

import numpy as np

from steerd.car_model.chassis import Chassis
from steerd.car_model.params import Car
from steerd.car_model.planar import CHASSIS
from steerd.estimator.actuation import History, dead_times
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Array, Belief
from steerd.estimator.motion import SIZE, noise_density
from steerd.estimator.sensors import Kind, Measurement, Sensor

WIDEST = 3
"""Most values of a measurement."""
_BELIEF = SIZE + SIZE * SIZE
_NODE = _BELIEF + WIDEST + 2
_MOST_NODES = 256
_NO_COMMAND = (nan, nan)
_PADDING = ((), (0.0, 0.0), (0.0,), ())
Link = tuple[Belief, Array, float, bool]
"""What a measurement leaves: belief, innovation, its square, and whether it was believed."""


class Kernel:
    """The machine code for one car; None from a method: ask Python, a number is not finite."""

    def __init__(
        self,
        library: ctypes.PyDLL,
        car: Car[float],
        chassis: Chassis,
        config: FilterConfig,
        sensors: Mapping[Kind, Sensor],
    ) -> None:
        self._setup = _pack_setup(car, chassis, config, sensors)
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
    ) -> list[Link] | None:
        """What each measurement of a chain leaves."""
        count = len(chain)
        if count > _MOST_NODES:
            return None
        given: list[float] = []
        for t_ns, kind, values in chain:
            given += (t_ns, kind, *values, *_PADDING[len(values)])
        request = self._pack_request(history, first, start_ns) + _measurements(count).pack(*given)
        if self._fuse(self._setup, request, count, self._where):
            return None
        rows = self._out[:count].copy()
        covariances = rows[:, SIZE:_BELIEF].reshape(count, SIZE, SIZE)
        beliefs = map(Belief, rows[:, :SIZE], covariances)
        innovations = rows[:, _BELIEF : _BELIEF + WIDEST]
        judged = rows[:, _BELIEF + WIDEST :].tolist()
        return [
            (belief, y[: len(m.values)], nis, believed > 0.0)
            for m, belief, y, (nis, believed) in zip(
                chain, beliefs, innovations, judged, strict=True
            )
        ]

    def predict(
        self, history: History, first: Belief, start_ns: int, stop_ns: int
    ) -> tuple[Belief, bool] | None:
        """The belief at `stop_ns` from the one of `start_ns`; whether it has a Cholesky factor."""
        if self._predict(
            self._setup, self._pack_request(history, first, start_ns, stop_ns), self._where
        ):
            return None
        row = self._out[0, : _BELIEF + 1].copy()
        return read_belief(row), row.item(_BELIEF) > 0.0

    def _pack_request(
        self, history: History, first: Belief, start_ns: int, stop_ns: int = 0
    ) -> bytes:
        """Two instants, the commands that can act after the first, and the belief then."""
        begin = max(bisect_right(history.times, start_ns - self._dead_time) - 1, 0)
        times = history.times[begin:]
        orders = [x for command in history.commands[begin:] for x in command or _NO_COMMAND]
        known = len(times)
        head = _request(known).pack(known, start_ns, stop_ns, *times, *orders)
        return head + first.mean.tobytes() + first.covariance.tobytes()


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


def _pack_setup(
    car: Car[float], chassis: Chassis, config: FilterConfig, sensors: Mapping[Kind, Sensor]
) -> bytes:
    """As `setup_t` has it."""
    numbers = [*car, *noise_density(config, 1.0), config.lateral_accel_density]
    numbers += (*map(float, dead_times(car)), float(CHASSIS.index(chassis)))
    return _numbers(len(numbers)).pack(*numbers) + b"".join(pack_sensor(sensors[k]) for k in Kind)


@lru_cache(maxsize=1024)
def _numbers(count: int) -> Struct:
    return Struct(f"={count}d")


@lru_cache(maxsize=1024)
def _request(known: int) -> Struct:
    return Struct(f"={3 + known}q{2 * known}d")


@lru_cache(maxsize=1024)
def _measurements(count: int) -> Struct:
    return Struct("=" + f"2q{WIDEST}d" * count)


def read_belief(row: Array) -> Belief:
    """A belief that lies in a row: mean, then covariance by rows."""
    return Belief(row[:SIZE], row[SIZE:_BELIEF].reshape(SIZE, SIZE))
