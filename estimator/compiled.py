"""The filter's inside by the compiled library: beliefs, measurements and commands in and out."""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref, c_char, c_double
from functools import lru_cache
from math import nan
from struct import Struct

import numpy as np

from steerd.car_model.chassis import Chassis
from steerd.car_model.native.library import Filter, load_function, model_label
from steerd.car_model.params import Car
from steerd.car_model.prediction import SIZE
from steerd.car_model.state import State
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import History, dead_times
from steerd.estimator.initial import Belief
from steerd.estimator.sensors import Kind, Measurement, Sensor
from steerd.steer_bus.quick_values import quick_value

WIDEST = 3  # most values of a measurement
_BELIEF = SIZE + SIZE * SIZE
_BELIEF_BYTES = 8 * _BELIEF
_PREDICTION = _BELIEF + SIZE + 2
_LINK = Struct(f"={_BELIEF_BYTES}s2d")
_NO_COMMAND = (nan, nan)
_PADDING = (0.0, 0.0)


@quick_value
class Link:
    """What a measurement leaves."""

    belief: Belief
    nis: float  # normalised innovation squared
    believed: bool


@quick_value
class Prediction:
    """The belief at an instant."""

    belief: Belief
    state: State[float]  # its mean
    sd: State[float]  # standard deviation of each state; NaN where its variance is none
    position_sd: float  # along the worst direction [m]
    sound: bool  # mean and covariance are finite, the covariance positive definite


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
        self._setup = byref(Filter(*(each.ctypes.data for each in self._arrays), *late))
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
            given += (t_ns, kind, *(*values, *_PADDING)[:WIDEST])
        asked = self._ask(history, first, start_ns, count=count) + _measurements(count).pack(*given)
        rows = (c_char * (count * _LINK.size))()
        self._fuse(self._setup, asked, rows)
        return [
            Link(Belief(numbers), nis, believed > 0.0)
            for numbers, nis, believed in _LINK.iter_unpack(rows)
        ]

    def predict(self, history: History, first: Belief, start_ns: int, stop_ns: int) -> Prediction:
        """The belief at `stop_ns` from the one of `start_ns`."""
        row = (c_double * _PREDICTION)()
        self._predict(self._setup, self._ask(history, first, start_ns, stop_ns), row)
        state: State[float] = State(*row[:SIZE])
        sd: State[float] = State(*row[_BELIEF : _BELIEF + SIZE])
        return Prediction(Belief(bytes(row)[:_BELIEF_BYTES]), state, sd, row[-2], row[-1] > 0.0)

    def _ask(
        self, history: History, first: Belief, start_ns: int, stop_ns: int = 0, count: int = 0
    ) -> bytes:
        """As `asked_t` has it, with the commands that can act after the first instant."""
        begin = max(bisect_right(history.times, start_ns - self._dead_time) - 1, 0)
        times = history.times[begin:]
        orders = [x for command in history.commands[begin:] for x in command or _NO_COMMAND]
        known = len(times)
        head = _request(known).pack(known, count, start_ns, stop_ns, *times, *orders)
        return head + first.numbers


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
