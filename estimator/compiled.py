"""The filter's inside by the compiled library: beliefs, measurements and commands in and out."""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref
from functools import lru_cache
from math import nan
from struct import Struct

import numpy as np

from steerd.car_model.chassis import Chassis
from steerd.car_model.native.library import Filter, load_function, model_label
from steerd.car_model.params import Car
from steerd.car_model.prediction import SIZE
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import History, dead_times
from steerd.estimator.initial import Array, Belief
from steerd.estimator.sensors import Kind, Measurement, Sensor

WIDEST = 3
"""Most values of a measurement."""
_BELIEF = SIZE + SIZE * SIZE
_NODE = _BELIEF + WIDEST + 2
_NO_COMMAND = (nan, nan)
_PADDING = ((), (0.0, 0.0), (0.0,), ())
Link = tuple[Belief, Array, float, bool]
"""What a measurement leaves: belief, innovation, its square, and whether it was believed."""


class Kernel:
    """The compiled filter of one car.

    Raises:
        LibraryError: the library was not built.
    """

    def __init__(
        self,
        car: Car[float],
        chassis: Chassis,
        config: FilterConfig,
        sensors: Mapping[Kind, Sensor],
    ) -> None:
        label = model_label((), chassis)
        late = dead_times(car)
        p, density = np.array(car), np.array(config.noise_density)
        q = np.empty(load_function(label, "filter_constant_count")() + 1)
        load_function(label, "filter_constants")(p.ctypes.data, 0.0, q.ctypes.data)
        instruments = np.array([_numbers_of(sensors[kind]) for kind in Kind])
        self._arrays = p, q, density, instruments  # they live as long as their addresses
        self._setup = Filter(*(each.ctypes.data for each in self._arrays), *late)
        self._dead_time = max(late)
        self._fuse: Callable[..., None] = load_function(label, "fuse")
        self._predict: Callable[..., None] = load_function(label, "predict")

    def __deepcopy__(self, memo: dict[int, object]) -> "Kernel":
        """Itself, where a whole loop is copied: it remembers nothing from one call to the next."""
        return self

    def fuse(
        self, history: History, first: Belief, start_ns: int, chain: Sequence[Measurement]
    ) -> list[Link]:
        """What each measurement of a chain leaves."""
        count = len(chain)
        given: list[float] = []
        for t_ns, kind, values in chain:
            given += (t_ns, kind, *values, *_PADDING[len(values)])
        asked = self._ask(history, first, start_ns, count=count) + _measurements(count).pack(*given)
        rows = np.empty((count, _NODE))
        self._fuse(byref(self._setup), asked, rows.ctypes.data)
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
    ) -> tuple[Belief, bool]:
        """The belief at `stop_ns` from the one of `start_ns`; whether it is sound."""
        row = np.empty(_BELIEF + 1)
        self._predict(
            byref(self._setup), self._ask(history, first, start_ns, stop_ns), row.ctypes.data
        )
        belief = Belief(row[:SIZE], row[SIZE:_BELIEF].reshape(SIZE, SIZE))
        return belief, row.item(_BELIEF) > 0.0

    def _ask(
        self, history: History, first: Belief, start_ns: int, stop_ns: int = 0, count: int = 0
    ) -> bytes:
        """As `asked_t` has it, with the commands that can act after the first instant."""
        begin = max(bisect_right(history.times, start_ns - self._dead_time) - 1, 0)
        times = history.times[begin:]
        orders = [x for command in history.commands[begin:] for x in command or _NO_COMMAND]
        known = len(times)
        head = _request(known).pack(known, count, start_ns, stop_ns, *times, *orders)
        return head + first.mean.tobytes() + first.covariance.tobytes()


def _numbers_of(sensor: Sensor) -> list[float]:
    """As `sensor_t` has it."""
    padding = [0.0] * (WIDEST - len(sensor.states))
    yaw = -1.0 if sensor.yaw_row is None else sensor.yaw_row
    head = [len(sensor.states), *sensor.states, *padding, sensor.gain]
    return [*head, *sensor.variances, *padding, sensor.gate, yaw]


@lru_cache(maxsize=1024)
def _request(known: int) -> Struct:
    return Struct(f"={4 + known}q{2 * known}d")


@lru_cache(maxsize=1024)
def _measurements(count: int) -> Struct:
    return Struct("=" + f"2q{WIDEST}d" * count)
