"""The compiled car for NumPy callers: many windows at once, values and derivatives.

`make_kernels(effects)` loads the compiled model; `march` and `march_back` are the simulator and its
adjoint over windows side by side, `read` gives instrument readings with forward sensitivities.
Parameters are one vector: the car's fields, then every effect's (see `trace.parameter_names`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.model import Model, memory_size
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.sysid.compiler.codegen import COLUMNS
from steerd.sysid.compiler.modules import load_module
from steerd.sysid.compiler.simd_rows import LANES
from steerd.sysid.compiler.threads import share_out, threads
from steerd.sysid.compiler.trace import parameter_names

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PLACED = 3
"""Of a window's first state: its place and heading."""
CACHE_LINE = 64
"""Bytes."""
TABLEAUS: dict[str, Array] = {
    "euler": np.array([[0.0], [1.0]]),
    "rk4": np.array([[0.0, 0.5, 0.5, 1.0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]]),
}
"""Reach and weight of each stage: a stage starts from the slope of the one before it."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """A compiled car with effects.

    Attributes:
        effects: what was compiled in, in the order of the parameters.
        names: of all parameters.
        memory: numbers that the effects remember; a state has 7 + memory numbers.
        module: the compiled functions.
        chassis: whose equations they are.
    """

    effects: tuple[Effect, ...]
    names: tuple[str, ...]
    memory: int
    module: ModuleType
    chassis: Chassis = SINGLE_TRACK

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process loads its own compiled functions: code does not travel."""
        return make_kernels, (self.effects, self.chassis)


class Held(NamedTuple):
    """Commands of several runs, one after the other, each held over a step.

    Attributes:
        rows: (rows, 2) steer [rad] and speed [m/s].
        h: the grid's step [s].
        substeps: integration steps to a command.
        integrator: `rk4` or `euler`.
    """

    rows: Array
    h: float
    substeps: int = 1
    integrator: str = "rk4"

    @property
    def fine(self) -> float:
        """Integration step [s]."""
        return self.h / self.substeps


def make_kernels(effects: Sequence[Effect] = (), chassis: Chassis = SINGLE_TRACK) -> Kernels:
    """The compiled car with these effects on this chassis (compiled the first time, then from the cache)."""
    chosen = tuple(effects)
    module = load_module(chosen, chassis)
    return Kernels(chosen, parameter_names(chosen), memory_size(chosen), module, chassis)


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


def constants_of(kernels: Kernels, parameters: Array, h: float) -> Array:
    """What depends on parameters and step alone, computed once."""
    q = np.zeros(max(kernels.module.CONSTANTS, 1))
    kernels.module.constants(parameters, h, q)
    return q


class Lanes(NamedTuple):
    """Windows arranged side by side: blocks of `LANES`, the last filled up with copies.

    Attributes:
        windows: how many lanes are real ones.
        runs: (blocks, LANES, 3) rows of the commands: first, after the last, at the first step.
        t: (blocks, LANES) time into the run [s].
    """

    windows: int
    runs: Indices
    t: Array

    @property
    def breadth(self) -> int:
        """How many lanes there are."""
        return self.t.size


def make_lanes(runs: Indices, t: Array) -> Lanes:
    """Arrange windows `(W, 3)`, starting `t` seconds into their runs."""
    count = len(t)
    pick = np.minimum(np.arange(-(-count // LANES) * LANES), count - 1)
    return Lanes(count, runs[pick].reshape(-1, LANES, 3), t[pick].reshape(-1, LANES))


def lane_view(path: Any, count: int) -> Any:
    """(moments, states, lanes) seen as (count, moments, states), without a copy."""
    seen = path.transpose(2, 0, 1) if isinstance(path, np.ndarray) else path.permute(2, 0, 1)
    return seen[:count]


def empty_path(moments: int, states: int, lanes: int) -> Array:
    """(moments, states, lanes) unset numbers; a row of lanes begins with a cache line."""
    size, line = moments * states * lanes, CACHE_LINE // 8
    space = np.empty(size + line)
    first = -(space.ctypes.data // 8) % line
    return space[first : first + size].reshape(moments, states, lanes)


def march(
    kernels: Kernels, parameters: Array, first: Array, held: Held, lanes: Lanes, steps: int
) -> Array:
    """Simulate windows side by side.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        first: (W, 7 + memory) states at the windows' starts.
        held: the commands.
        lanes: the windows.
        steps: integration steps, the same for all.

    Returns:
        (steps + 1, 7 + memory, lanes); see `lane_view`.
    """
    path = empty_path(steps + 1, first.shape[1], lanes.breadth)
    path[0] = first[np.minimum(np.arange(lanes.breadth), len(first) - 1)].T
    q, tableau = constants_of(kernels, parameters, held.fine), TABLEAUS[held.integrator]

    def block(number: int, _worker: int) -> None:
        kernels.module.simulate_block(
            parameters, q, held.fine, tableau, path.reshape(-1), lanes.breadth, number * LANES,
            held.rows, lanes.runs[number], lanes.t[number], held.substeps,
        )  # fmt: skip

    share_out(block, len(lanes.runs), steps)
    return path


class Slopes(NamedTuple):
    """Derivatives of a loss.

    By parameters (P,), first states (W, 7 + memory) and commands (rows, 2); the last empty unless
    they were wanted.
    """

    parameters: Array
    first: Array
    commands: Array


def march_back(
    kernels: Kernels,
    parameters: Array,
    path: Array,
    bars: Array,
    held: Held,
    lanes: Lanes,
    commands: bool = True,
) -> Slopes:
    """The adjoint of `march`.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        path: what it returned.
        bars: (W, moments, states) the loss's derivatives by the states.
        held: the commands.
        lanes: the windows.
        commands: whether derivatives by the commands are wanted.
    """
    h, blocks = held.fine, len(lanes.runs)
    q, tableau = constants_of(kernels, parameters, h), TABLEAUS[held.integrator]
    workers = min(threads(), blocks)
    into = np.zeros((workers, *held.rows.shape) if commands else (workers, 0, 2))
    slopes, first = np.zeros((blocks, len(parameters))), np.empty((blocks, path.shape[1] * LANES))
    late, (flat, strides) = np.zeros((blocks, 2 * LANES)), _flat(bars)

    def block(number: int, worker: int) -> None:
        kernels.module.adjoint_block(
            parameters, q, h, tableau, path.reshape(-1), lanes.breadth, number * LANES, flat,
            strides, lanes.windows, held.rows, into[worker], lanes.runs[number], lanes.t[number],
            held.substeps, first[number], slopes[number], late[number],
        )  # fmt: skip

    share_out(block, blocks, len(path))
    lateness = late.reshape(blocks, 2, LANES).sum(axis=(0, 2)) / h
    total = slopes.sum(axis=0) + delay_slopes(kernels, parameters, np.array([*lateness, 0.0]))
    by_window = first.reshape(blocks, -1, LANES).transpose(0, 2, 1).reshape(lanes.breadth, -1)
    return Slopes(total, by_window[: lanes.windows], into.sum(axis=0))


def _flat(bars: Array) -> tuple[Array, Indices]:
    """An array of any order as it lies in memory, and its strides in numbers."""
    order = np.argsort([-stride for stride in bars.strides], kind="stable")
    packed = bars.transpose(order)
    if not packed.flags.c_contiguous:
        bars = packed = np.ascontiguousarray(bars)
    return packed.reshape(-1), np.array(bars.strides) // bars.itemsize


def delay_slopes(kernels: Kernels, parameters: Array, bars: Array) -> Array:
    """Derivatives by the parameters, given those by the dead times (steer, drive, pose)."""
    seeds = np.zeros((len(parameters), COLUMNS))
    slopes = np.zeros(len(parameters))
    q = constants_of(kernels, parameters, 1.0)
    for start in range(0, len(parameters), COLUMNS):
        part = np.arange(start, min(start + COLUMNS, len(parameters)))
        seeds[:] = 0.0
        seeds[part, part - start] = 1.0
        columns = kernels.module.delay_columns(parameters, q, 1.0, seeds, np.zeros(3), COLUMNS)
        slopes[part] = (bars @ columns[: 3 * COLUMNS].reshape(3, COLUMNS))[: len(part)]
    return slopes


def delays_of(kernels: Kernels, parameters: Array) -> Array:
    """Dead times of steer, drive and pose [s]."""
    q = constants_of(kernels, parameters, 1.0)
    delays: Array = kernels.module.delays_at(parameters, q, 1.0)
    return delays


class Stations(NamedTuple):
    """Where windows are read.

    Attributes:
        places: (S, 4) step within the window, first reading (0 x, 3 wheel speed, 4 yaw rate), row
            of the result, and 1 for a pose (three readings, as late as poses are); sorted by
            window and time.
        shares: (S,) place within the step.
        spans: (W + 1,) stations of each window.
        rows: of the result.
    """

    places: Indices
    shares: Array
    spans: Indices
    rows: int


class Windows(NamedTuple):
    """Windows to be read one by one.

    Attributes:
        spans: (W, 5) rows of the commands (first, after the last, at the first step), integration
            steps, and steps of the actuators alone before the first.
        t: (W,) time into the run at the first step [s].
    """

    spans: Indices
    t: Array


def read(
    kernels: Kernels,
    parameters: Array,
    seeds: Array,
    first: Array,
    dfirst: Array,
    held: Held,
    windows: Windows,
    stations: Stations,
    scale: Array | None = None,
    placed: bool = False,
) -> tuple[Array, Array]:
    """Instrument readings and their derivatives.

    Args:
        kernels: the compiled car.
        parameters: (P,).
        seeds: (P, columns) derivative of the parameters by the columns.
        first: (W, 7) first states; the steer is what is added to the settled one.
        dfirst: (7, columns) derivative of the first state by the columns.
        held: the commands.
        windows: the windows.
        stations: where to read.
        scale: (rows,) by which each row of derivatives is multiplied.
        placed: whether the derivatives by place and heading of the windows' starts follow as three
            more columns; right for a car without effects, which is the same everywhere.

    Returns:
        Readings (rows,) and (scaled) derivatives (rows, columns), three more if `placed`.

    Raises:
        ValueError: more columns than a kernel holds.
    """
    columns = seeds.shape[1]
    if columns > COLUMNS:
        raise ValueError(f"{columns} columns; a kernel holds {COLUMNS}")
    padded, more = _whole_rows(columns), PLACED if placed else 0
    width = max(padded, _whole_rows(columns + more))
    state = np.zeros((len(first), 7 + kernels.memory))
    state[:, :7] = first
    y, jy = np.empty(stations.rows), np.empty((stations.rows, width))
    scale = np.ones(stations.rows) if scale is None else scale
    q = constants_of(kernels, parameters, held.fine)
    seeds, dfirst, late = _padded(seeds, padded), _padded(dfirst, padded), np.zeros(3)
    late_columns = kernels.module.delay_columns(parameters, q, held.fine, seeds, late, padded)
    tableau, bounds, flat = TABLEAUS[held.integrator], stations.spans, jy.reshape(-1)

    def window(w: int, _worker: int) -> None:
        a, b = bounds[w], bounds[w + 1]
        kernels.module.march_window(
            parameters, q, held.fine, tableau, seeds, late, late_columns, held.rows,
            windows.spans[w], windows.t[w], held.substeps, state[w], dfirst,
            stations.places[a:b], stations.shares[a:b], scale, y, flat, width,
            columns if placed else 0, padded,
        )  # fmt: skip

    share_out(window, len(first), int(windows.spans[:, 3].mean()))
    return y, jy[:, : columns + more]


def _whole_rows(columns: int) -> int:
    return -(-columns // LANES) * LANES


def _padded(matrix: Array, columns: int) -> Array:
    wide = np.zeros((len(matrix), columns))
    wide[:, : matrix.shape[1]] = matrix
    return wide
