"""The compiled car for NumPy callers: many windows at once, values and derivatives.

`make_kernels(effects)` loads the compiled model; `march` and `march_back` are the simulator and its
adjoint over windows side by side, `compute_readings` gives instrument readings with forward
sensitivities. Parameters are one vector: the car's fields, then every effect's (see
`trace.parameter_names`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.model import Model, memory_size
from steerd.car_model.native.threads import share_out, threads
from steerd.car_model.native.trace import parameter_names
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import State
from steerd.sysid.compiler.arguments import (
    Array,
    Block,
    Directions,
    Gradients,
    Indices,
    Integration,
    Readings,
    Scatter,
    StateGradient,
    WindowBlock,
)
from steerd.sysid.compiler.codegen import SENSITIVITIES
from steerd.sysid.compiler.modules import load_module
from steerd.sysid.compiler.simd_rows import SLOTS

STATES = len(State._fields)
"""Numbers of a state before the effects' memory."""
STEER = State._fields.index("steer")
START_POSE = 3
"""Derivatives by the pose of a window's start: x, y, yaw."""
CACHE_LINE = 64
"""[byte]."""
TABLEAUS: dict[str, Array] = {
    "euler": np.array([[0.0], [1.0]]),
    "midpoint": np.array([[0.0, 0.5], [0.0, 1.0]]),
    "rk4": np.array([[0.0, 0.5, 0.5, 1.0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]]),
}
"""Node and weight of each stage (Butcher): a stage starts from the slope of the one before it."""


@dataclass(frozen=True, eq=False)
class Kernels:
    """A compiled car with effects.

    Attributes:
        effects: what was compiled in, in the order of the parameters.
        names: of all parameters.
        memory: numbers that the effects remember; a state has STATES + memory numbers.
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


class HeldCommands(NamedTuple):
    """Commands of several runs, one after the other, each held over a step.

    Attributes:
        rows: (rows, 2) steer [rad] and speed [m/s].
        h: the grid's step [s].
        substeps: integration steps to a command.
        integrator: of `TABLEAUS`.
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
    """The compiled car with these effects; compiled the first time, then from the cache."""
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


def _integration(kernels: Kernels, parameters: Array, held: HeldCommands) -> Integration:
    q = constants_of(kernels, parameters, held.fine)
    return Integration(parameters, q, held.fine, TABLEAUS[held.integrator], held.substeps)


class WindowBlocks(NamedTuple):
    """Windows arranged side by side: blocks of `SLOTS`, the last padded with copies.

    Attributes:
        windows: how many slots hold a window of their own.
        runs: (blocks, SLOTS, 3) rows of the commands: first, after the last, at the first step.
        t: (blocks, SLOTS) time into the run [s].
    """

    windows: int
    runs: Indices
    t: Array

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
    integration, flat = tuple(_integration(kernels, parameters, held)), path.reshape(-1)

    def simulate(number: int, _worker: int) -> None:
        kernels.module.simulate_block(integration, tuple(_block(held, blocks, number)), flat)

    share_out(simulate, len(blocks.runs), steps)
    return path


def _block(held: HeldCommands, blocks: WindowBlocks, number: int) -> Block:
    return Block(held.rows, blocks.runs[number], blocks.t[number], number * SLOTS, blocks.slots)


class Windows(NamedTuple):
    """Windows of any lengths.

    Attributes:
        spans: (W, 5) rows of the commands (first, after the last, at the first step), integration
            steps, and steps of the actuators alone before the first.
        t: (W,) time into the run at the first step [s].
    """

    spans: Indices
    t: Array


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
    state, settling = first.copy(), windows.spans[:, 4]
    integration = tuple(_integration(kernels, parameters, held))
    blocks = _in_blocks(np.argsort(settling, kind="stable"))

    def block(number: int, _worker: int) -> None:
        here = blocks[number]
        runs, longest = windows.spans[here, :3], -(-int(settling[here].max()) // held.substeps)
        runs[:, 2] -= longest
        place = Block(held.rows, runs, windows.t[here] - longest * held.h, 0, SLOTS)
        rows = np.ascontiguousarray(state[here].T).reshape(-1)
        kernels.module.settle_block(integration, tuple(place), settling[here], rows)
        state[here] = rows.reshape(-1, SLOTS).T

    share_out(block, len(blocks), SLOTS * int(settling.mean()))
    state[:, STEER] += np.where(settling > 0, first[:, STEER], 0.0)
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
    integration, flat = tuple(_integration(kernels, parameters, held)), path.reshape(-1)
    loss = tuple(StateGradient(*_flat(bars), blocks.windows))
    rows = held.rows.shape if commands else (0, 2)
    by_commands = np.zeros((min(threads(), count), *rows))
    by_parameters, by_first = np.zeros((count, len(parameters))), np.empty((count, states * SLOTS))
    by_delays = np.zeros((count, 2 * SLOTS))

    def simulate_back(number: int, worker: int) -> None:
        into = Gradients(
            by_first[number], by_parameters[number], by_delays[number], by_commands[worker]
        )
        block = _block(held, blocks, number)
        kernels.module.adjoint_block(integration, tuple(block), flat, loss, tuple(into))

    share_out(simulate_back, count, len(path))
    delays = by_delays.reshape(count, 2, SLOTS).sum(axis=(0, 2)) / held.fine
    through_delays = delay_slopes(kernels, parameters, np.array([*delays, 0.0]))
    first = by_first.reshape(count, -1, SLOTS).transpose(0, 2, 1).reshape(blocks.slots, -1)
    total = by_parameters.sum(axis=0) + through_delays
    return Slopes(total, first[: blocks.windows], by_commands.sum(axis=0))


def _flat(bars: Array) -> tuple[Array, Indices]:
    """An array of any order as it lies in memory, and its strides in numbers."""
    order = np.argsort([-stride for stride in bars.strides], kind="stable")
    packed = bars.transpose(order)
    if not packed.flags.c_contiguous:
        bars = packed = np.ascontiguousarray(bars)
    return packed.reshape(-1), np.array(bars.strides) // bars.itemsize


def delay_slopes(kernels: Kernels, parameters: Array, bars: Array) -> Array:
    """Derivatives by the parameters, given those by the dead times (steer, drive, pose)."""
    slopes: Array = bars @ _delays(kernels, parameters)[1]
    return slopes


def delays_of(kernels: Kernels, parameters: Array) -> Array:
    """Dead times of steer, drive and pose [s]."""
    return _delays(kernels, parameters)[0]


def _delays(kernels: Kernels, parameters: Array) -> tuple[Array, Array]:
    """Dead times (3,) [s] and their derivatives by the parameters (3, P)."""
    module = kernels.module
    found = module.delays_at(parameters, constants_of(kernels, parameters, 1.0), 1.0)
    slopes = np.zeros((3, len(parameters)))
    number, output, parameter = module.DELAYS_BY.T
    slopes[output, parameter] = found[3 + number]
    return found[:3], slopes


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


def compute_readings(
    kernels: Kernels,
    parameters: Array,
    seeds: Array,
    first: Array,
    dfirst: Array,
    held: HeldCommands,
    windows: Windows,
    stations: Stations,
    scale: Array | None = None,
    start_pose: bool = False,
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
        scale: (rows,) by which each row of derivatives is multiplied.
        start_pose: whether the derivatives by position and heading of the windows' starts follow as
            three more; right for a car without effects, which is the same everywhere.

    Returns:
        Readings (rows,) and (scaled) derivatives (rows, n), three more if `start_pose`.

    Raises:
        ValueError: more directions than a kernel holds.
    """
    count = seeds.shape[1]
    if count > SENSITIVITIES:
        raise ValueError(f"{count} sensitivities; a kernel holds {SENSITIVITIES}")
    total = count + (START_POSE if start_pose else 0)
    width = _whole_rows(total)
    state = np.zeros((len(first), STATES + kernels.memory))
    state[:, :STATES] = first
    y, jy = np.empty(stations.rows), np.empty((stations.rows, width))
    scale = np.ones(stations.rows) if scale is None else scale
    integration = _integration(kernels, parameters, held)
    shared = tuple(integration), tuple(_directions(kernels, integration, seeds, dfirst))
    ranges = np.column_stack([stations.spans[:-1], stations.spans[1:]])
    flat, pose = jy.reshape(-1), count if start_pose else 0
    blocks = _in_blocks(np.lexsort((windows.spans[:, 4], windows.spans[:, 3])))

    def block(number: int, _worker: int) -> None:
        here = blocks[number]
        own = min(SLOTS, len(first) - number * SLOTS)
        rows = np.ascontiguousarray(state[here].T).reshape(-1)
        place = WindowBlock(held.rows, windows.spans[here], windows.t[here], rows, own)
        into = Readings(stations.places, stations.shares, ranges[here], scale, y, flat, width, pose)
        kernels.module.march_windows(*shared, tuple(place), tuple(into))

    share_out(block, len(blocks), SLOTS * int(windows.spans[:, 3].mean()))
    return y, jy[:, :total]


def _directions(
    kernels: Kernels, integration: Integration, seeds: Array, dfirst: Array
) -> Directions:
    """The directions in whole rows, with the dead times' derivatives by them."""
    module, count = kernels.module, _whole_rows(seeds.shape[1])
    delays, slopes = _delays(kernels, integration.p)
    by_delays = np.zeros((3, SENSITIVITIES))
    by_delays[:, : seeds.shape[1]] = slopes @ seeds / integration.h
    pieces = (
        _scatter(module.ACTUATORS_BY, module.ACTUATORS_INPUTS, seeds),
        _scatter(module.RATES_BY, module.RATES_INPUTS, seeds),
        _scatter(module.SPECIALISED_BY, module.RATES_INPUTS, seeds),
        _scatter(module.REMEMBER_BY, module.REMEMBER_INPUTS, seeds),
        _scatter(module.OBSERVE_BY, module.STATES, seeds, stride=1),
    )
    return Directions(
        _padded(dfirst, count), delays / integration.h, by_delays.reshape(-1), count, *pieces
    )


def _scatter(by: Indices, inputs: int, seeds: Array, stride: int = SLOTS) -> Any:
    """What a piece's derivatives by parameters add to its outputs, as a plain tuple.

    Args:
        by: (S, 3) number of the derivative, output, parameter.
        inputs: rows of the workspace before the outputs'.
        seeds: (P, n) derivative of the parameters by the directions.
        stride: numbers from one derivative to the next.
    """
    number, output, parameter = by.T
    entry, direction = np.nonzero(seeds[parameter])
    to = (inputs + output[entry]) * SENSITIVITIES + direction
    return tuple(Scatter(stride * number[entry], to, seeds[parameter[entry], direction]))


def _in_blocks(order: Indices) -> Indices:
    """(blocks, SLOTS) windows in an order that puts alike ones together, filled up with copies."""
    filled = order[np.minimum(np.arange(_whole_rows(len(order))), len(order) - 1)]
    return filled.reshape(-1, SLOTS)


def _whole_rows(numbers: int) -> int:
    return -(-numbers // SLOTS) * SLOTS


def _padded(matrix: Array, width: int) -> Array:
    wide = np.zeros((len(matrix), width))
    wide[:, : matrix.shape[1]] = matrix
    return wide
