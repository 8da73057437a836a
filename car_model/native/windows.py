"""The compiled car for NumPy callers: many windows at once, values and derivatives.

`make_kernels(effects)` finds a car in the library; `march` and `march_back` are the simulator and
its adjoint over windows side by side, `compute_readings` gives instrument readings with forward
sensitivities. Parameters are one vector: the car's fields, then every effect's (see
`trace.parameter_names`). A car with some effects is the car with every effect of the library, the
others at their nulls, where they change nothing, bit for bit.
"""

from collections.abc import Sequence
from ctypes import byref
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model, memory_size
from steerd.car_model.native import library
from steerd.car_model.native.threads import share_out, threads
from steerd.car_model.native.trace import parameter_names
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import State

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SLOTS = 8  # windows side by side: one vector of AVX-512, two of AVX2, four of NEON
STATES = len(State._fields)  # numbers of a state before the effects' memory
STEER = State._fields.index("steer")
CACHE_LINE = 64  # [byte]
TABLEAUS: dict[str, Array] = {
    "euler": np.array([[0.0], [1.0]]),
    "midpoint": np.array([[0.0, 0.5], [0.0, 1.0]]),
    "rk4": np.array([[0.0, 0.5, 0.5, 1.0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]]),
}
"""Node and weight of each stage (Butcher): a stage starts from the slope of the one before it."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """A compiled car with effects."""

    effects: tuple[Effect, ...]  # in the order of the parameters
    names: tuple[str, ...]  # of all parameters
    memory: int  # numbers that the effects remember; a state has STATES + memory numbers
    chassis: Chassis  # whose equations they are
    nulls: Array = field(repr=False)  # parameters of the library's car, every effect at its null
    places: Indices = field(repr=False)  # where `names` are among them

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process loads its own library: code does not travel."""
        return make_kernels, (self.effects, self.chassis)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the library, without Python's lock."""
        return self.function(name)(*arguments)

    def function(self, name: str) -> Any:
        """A function of the library."""
        return library.load_function(library.model_label(self.effects, self.chassis), name)

    def spread(self, rows: Array) -> Array:
        """(P, ...) rows by parameter among those of the library's car, zero elsewhere."""
        wide = np.zeros((len(self.nulls), *rows.shape[1:]))
        wide[self.places] = rows
        return wide

    def full(self, parameters: Array) -> Array:
        """All parameters of the library's car."""
        every = self.nulls.copy()
        every[self.places] = parameters
        return every


class HeldCommands(NamedTuple):
    """Commands of several runs, one after the other, each held over a step."""

    rows: Array  # (rows, 2) steer [rad] and speed [m/s]
    h: float  # the grid's step [s]
    substeps: int = 1  # integration steps to a command
    integrator: str = "rk4"  # of `TABLEAUS`

    @property
    def fine(self) -> float:
        """Integration step [s]."""
        return self.h / self.substeps


@lru_cache(maxsize=256)
def _make_kernels(effects: tuple[Effect, ...], chassis: Chassis) -> Kernels:
    own, every = parameter_names(effects), tuple(EFFECTS.values()) if effects else ()
    names = {name: place for place, name in enumerate(parameter_names(every))}
    unknown = [effect.name for effect in effects if effect.name not in EFFECTS]
    if unknown:
        raise ValueError(f"the library was built without {unknown[0]}")
    places = np.array([names[name] for name in own])
    nulls = np.array([*[0.0] * len(Car._fields), *(v for e in every for v in e.nulls)])
    return Kernels(effects, own, memory_size(every), chassis, nulls, places)


def make_kernels(effects: Sequence[Effect] = (), chassis: Chassis = SINGLE_TRACK) -> Kernels:
    """The compiled car with these effects, always the same value for the same car.

    Raises:
        ValueError: an effect is not one of the library's.
    """
    return _make_kernels(tuple(effects), chassis)


def parameter_vector(model: Model[float]) -> Array:
    """All parameters of a model in the kernels' order."""
    return np.array([*model.car, *(value for values in model.values for value in values)])


def model_of(kernels: Kernels, parameters: Array) -> Model[float]:
    """The model that a vector of parameters describes."""
    rest = iter(parameters[len(Car._fields) :].tolist())
    values = tuple(tuple(next(rest) for _ in e.parameters) for e in kernels.effects)
    return Model(
        Car(*parameters[: len(Car._fields)].tolist()), kernels.effects, values, kernels.chassis
    )


class CarNumbers(NamedTuple):
    """What the library's functions take of a car; the arrays live as long as this."""

    p: Array  # parameters of the library's car
    q: Array  # what depends on them and the step alone
    integration: library.Integration  # both, and how to integrate


def car_numbers(
    kernels: Kernels, parameters: Array, h: float, integrator: str, substeps: int
) -> CarNumbers:
    """A car's numbers for steps of `h` seconds."""
    p, tableau = kernels.full(parameters), TABLEAUS[integrator]
    q = np.empty(kernels.call("constant_count") + 1)
    kernels.call("constants", _at(p), h, _at(q))
    stages = tableau.shape[1]
    return CarNumbers(p, q, library.Integration(_at(p), _at(q), _at(tableau), h, stages, substeps))


def _held_car(kernels: Kernels, parameters: Array, held: HeldCommands) -> CarNumbers:
    return car_numbers(kernels, parameters, held.fine, held.integrator, held.substeps)


def _at(array: Array | Indices | NDArray[np.uint8]) -> int:
    """Where an array's numbers begin."""
    return int(array.ctypes.data)


def _each(array: Array | Indices) -> range:
    """Where the numbers of each of its first index begin; the array must outlive their use."""
    first, size = _at(array), array[0].nbytes
    return range(first, first + len(array) * size, size)


class WindowBlocks(NamedTuple):
    """Windows arranged side by side: blocks of `SLOTS`, the last padded with copies."""

    windows: int  # how many slots hold a window of their own
    # (blocks, SLOTS, 3) rows of the commands: first, after the last, at the first step
    runs: Indices
    t: Array  # (blocks, SLOTS) time into the run [s]

    @property
    def slots(self) -> int:
        """How many slots there are."""
        return self.t.size


def make_window_blocks(runs: Indices, t: Array) -> WindowBlocks:
    """Arrange windows `(W, 3)`, starting `t` seconds into their runs."""
    count = len(t)
    pick = np.minimum(np.arange(_whole_rows(count)), count - 1)
    return WindowBlocks(count, runs[pick].reshape(-1, SLOTS, 3), t[pick].reshape(-1, SLOTS))


def view_by_window(path: Any, count: int) -> Any:
    """(moments, states, slots) viewed as (count, moments, states), without a copy."""
    seen = path.transpose(2, 0, 1) if isinstance(path, np.ndarray) else path.permute(2, 0, 1)
    return seen[:count]


def empty_path(moments: int, states: int, slots: int) -> Array:
    """(moments, states, slots) unset numbers; a row of slots begins with a cache line."""
    size, line = moments * states * slots, CACHE_LINE // 8
    space = np.empty(size + line)
    first = -(space.ctypes.data // 8) % line
    return space[first : first + size].reshape(moments, states, slots)


def march(
    kernels: Kernels,
    parameters: Array,
    first: Array,
    held: HeldCommands,
    blocks: WindowBlocks,
    steps: int,
) -> Array:
    """Simulate windows side by side.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        first: (W, STATES + memory) states at the windows' starts.
        held: the commands.
        blocks: the windows.
        steps: integration steps, the same for all.

    Returns:
        (steps + 1, STATES + memory, slots); see `view_by_window`.
    """
    path = empty_path(steps + 1, first.shape[1], blocks.slots)
    path[0] = first[np.minimum(np.arange(blocks.slots), len(first) - 1)].T
    car = _held_car(kernels, parameters, held)
    spans = _spans(blocks, steps)

    def simulate(number: int, _worker: int) -> None:
        into = _at(path) + number * SLOTS * path.itemsize
        block = _block(held, spans[number], blocks.t[number])
        kernels.call("march", byref(car.integration), byref(block), steps, blocks.slots, into)

    share_out(simulate, len(blocks.runs), steps)
    return path


def _spans(blocks: WindowBlocks, steps: int) -> Indices:
    """(blocks, SLOTS, 5) as `Windows.spans`, without settling."""
    spans = np.zeros((*blocks.t.shape, 5), np.int64)
    spans[:, :, :3] = blocks.runs
    spans[:, :, 3] = steps
    return spans


def _block(held: HeldCommands, spans: Indices, t: Array) -> library.Block:
    return library.Block(_at(held.rows), _at(spans), _at(t))


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of any lengths."""

    # (W, 5) rows of the commands (first, after the last, at the first step), integration steps,
    # and steps of the actuators alone before the first
    spans: Indices
    t: Array  # (W,) time into the run at the first step [s]

    @cached_property
    def blocks(self) -> tuple[Indices, Indices, Array]:
        """(blocks, SLOTS) alike windows side by side, filled with copies; their `spans` and `t`."""
        order = np.lexsort((self.spans[:, 4], self.spans[:, 3]))
        each = np.resize(order, _whole_rows(len(order))).reshape(-1, SLOTS)
        return each, self.spans[each], self.t[each]


def settle(
    kernels: Kernels, parameters: Array, first: Array, held: HeldCommands, windows: Windows
) -> Array:
    """First states (W, STATES + memory) with steer and memory as the commands before bring them.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        first: (W, STATES + memory) states; their steer is added to the settled one.
        held: the commands.
        windows: in integration steps; those of the same block settle side by side.
    """
    state = first.copy()
    car = _held_car(kernels, parameters, held)
    blocks, spans, t = windows.blocks

    def block(number: int, _worker: int) -> None:
        rows = np.ascontiguousarray(first[blocks[number]].T)
        place = _block(held, spans[number], t[number])
        kernels.call("settled", byref(car.integration), byref(place), _at(rows))
        state[blocks[number]] = rows.T

    share_out(block, len(blocks), SLOTS * int(windows.spans[:, 4].mean()))
    return state


class Slopes(NamedTuple):
    """Derivatives of a loss.

    By parameters (P,), first states (W, STATES + memory) and commands (rows, 2); the last empty
    unless they were asked for.
    """

    parameters: Array
    first: Array
    commands: Array


def march_back(
    kernels: Kernels,
    parameters: Array,
    path: Array,
    bars: Array,
    held: HeldCommands,
    blocks: WindowBlocks,
    commands: bool = True,
) -> Slopes:
    """The adjoint of `march`.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        path: what it returned.
        bars: (W, moments, states) the loss's derivatives by the states.
        held: the commands.
        blocks: the windows.
        commands: whether to compute derivatives by the commands.
    """
    count, states = len(blocks.runs), path.shape[1]
    car, steps = _held_car(kernels, parameters, held), len(path) - 1
    values, strides = _flat(bars)
    spans, rows = _spans(blocks, steps), held.rows.shape if commands else (0, 2)
    by_commands = np.zeros((min(threads(), count), *rows))
    by_parameters, by_delays = np.zeros((count, len(car.p))), np.zeros((count, 2))
    by_first = np.empty((count, states, SLOTS))

    def simulate_back(number: int, worker: int) -> None:
        block = _block(held, spans[number], blocks.t[number])
        loss = library.Loss(_at(values), *strides.tolist(), blocks.windows, number * SLOTS)
        into = _at(path) + number * SLOTS * path.itemsize
        kernels.call(
            "march_back", byref(car.integration), byref(block), steps, blocks.slots, into,
            byref(loss), _at(by_first[number]), _at(by_parameters[number]), _at(by_delays[number]),
            _at(by_commands[worker]) if commands else None,
        )  # fmt: skip

    share_out(simulate_back, count, len(path))
    delays = np.array([*by_delays.sum(axis=0) / held.fine, 0.0])
    first = by_first.transpose(0, 2, 1).reshape(blocks.slots, -1)
    total = by_parameters.sum(axis=0)[kernels.places] + delays @ _delays(kernels, parameters)[1]
    return Slopes(total, first[: blocks.windows], by_commands.sum(axis=0))


def _flat(bars: Array) -> tuple[Array, Indices]:
    """An array of any order as it lies in memory, and its strides in numbers."""
    order = np.argsort([-stride for stride in bars.strides], kind="stable")
    packed = bars.transpose(order)
    if not packed.flags.c_contiguous:
        bars = packed = np.ascontiguousarray(bars)
    return packed.reshape(-1), np.array(bars.strides) // bars.itemsize


def delays_of(kernels: Kernels, parameters: Array) -> Array:
    """Dead times of steer, drive and pose [s]."""
    return _delays(kernels, parameters)[0]


def _delays(kernels: Kernels, parameters: Array) -> tuple[Array, Array]:
    """Dead times (3,) [s] and their derivatives by the parameters (3, P)."""
    car = car_numbers(kernels, parameters, 1.0, "euler", 1)
    found, slopes = np.empty(3), np.zeros((3, len(car.p)))
    kernels.call("delays", _at(car.p), _at(car.q), _at(found), _at(slopes))
    return found, slopes[:, kernels.places]


class Stations(NamedTuple):
    """Where windows are read."""

    # (S, 4) step within the window, first reading (0 x, 3 wheel speed, 4 yaw rate), row of the
    # result, and 1 for a pose (three readings, as late as poses are); sorted by window and time
    places: Indices
    shares: Array  # (S,) place within the step
    spans: Indices  # (W + 1,) stations of each window
    rows: int  # of the result


def compute_readings(
    kernels: Kernels,
    parameters: Array,
    seeds: Array,
    first: Array,
    dfirst: Array,
    held: HeldCommands,
    windows: Windows,
    stations: Stations,
) -> tuple[Array, Array]:
    """Instrument readings and their forward sensitivities.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        seeds: (P, n) derivative of the parameters by each of n directions.
        first: (W, STATES) first states; the steer is what is added to the settled one.
        dfirst: (STATES, n) derivative of the first state by the directions.
        held: the commands.
        windows: the windows.
        stations: where to read.

    Returns:
        Readings (rows,) and derivatives (rows, n).
    """
    count = seeds.shape[1]
    state = np.zeros((len(first), STATES + kernels.memory))
    state[:, :STATES] = first
    y, jy = np.empty(stations.rows), np.empty((stations.rows, count))
    car = _held_car(kernels, parameters, held)
    wide, start = kernels.spread(seeds), np.ascontiguousarray(dfirst)
    late = _delays(kernels, parameters)[1] @ seeds / held.fine if count else np.empty((3, 0))
    moved: NDArray[np.uint8] = np.any(wide, axis=1).astype(np.uint8)
    directions = library.Directions(count, _at(moved), _at(wide), _at(start), _at(late))
    blocks, spans, t = windows.blocks
    ranges = np.column_stack([stations.spans[:-1], stations.spans[1:]])[blocks]
    ranges.reshape(-1, 2)[len(first) :, 1] = 0  # copies are not read
    rows = np.ascontiguousarray(state[blocks].transpose(0, 2, 1))
    read, into = (_at(stations.places), _at(stations.shares)), (_at(y), _at(jy))
    starts = _each(rows), _each(ranges), _each(spans), _each(t)
    commands = _at(held.rows)

    def block(number: int, _worker: int) -> None:
        row, own, span, time = (at[number] for at in starts)
        place, readings = library.Block(commands, span, time), library.Readings(*read, own, *into)
        kernels.call(
            "readings", byref(car.integration), byref(place), byref(directions), row,
            byref(readings),
        )  # fmt: skip

    share_out(block, len(blocks), SLOTS * int(windows.spans[:, 3].mean()))
    return y, jy


def _whole_rows(numbers: int) -> int:
    return -(-numbers // SLOTS) * SLOTS
