"""How hidden pushes would show: the response of every reading to small inputs within a window.

Five inputs in pieces of a tenth of a second: accelerations along, across and about the car (what
the equations of motion miss; one impulse in the middle of the piece), and errors of what the two
actuators aim at (held over the piece). Finite differences of the compiled car.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.chassis import SPEED_KINEMATIC
from steerd.car_model.model import observe
from steerd.car_model.native.windows import (
    STATES,
    HeldCommands,
    delays_of,
    make_window_blocks,
    march,
    model_of,
    settle,
    view_by_window,
)
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.state import State
from steerd.sysid.data.data_checks import Array, Indices
from steerd.sysid.inference.predictor import Predictor

INPUTS: tuple[str, ...] = ("accel", "lateral", "yaw", "steer", "drive")
"""Which equation an input belongs to: speed, side slip, yaw rate; steering and drive actuator."""
PIECE = 0.1  # length over which an input is constant [s]
_SIZES = (0.2, 0.2, 1.0, 0.005, 0.05)  # of differences: [m/s^2], [m/s^2], [rad/s^2], [rad], [m/s]
_IMPULSES = 3  # the first inputs are impulses on the chassis


class _Nominal(NamedTuple):
    """The trajectory that is pushed."""

    predictor: Predictor  # the windows
    parameters: Array  # (P,) of the car
    first: Array  # (W, 7 + memory) states at the windows' begin
    held: HeldCommands  # the commands in steps of the window that needs the shortest
    steps: int  # of each window

    def march(self, first: Array, held: HeldCommands, runs: Indices, t: Array, steps: int) -> Array:
        """States (windows, moments, 7 + memory) at every step from the first ones."""
        blocks, kernels = make_window_blocks(runs, t), self.predictor.augmented.kernels
        path = march(kernels, self.parameters, first, held, blocks, steps)
        return np.ascontiguousarray(view_by_window(path, len(first)))

    def shown(self, path: Array) -> Array:
        """(W, D) what the instruments read along a path."""
        predictor = self.predictor
        layout, fine, kernels = predictor.layout, self.held.fine, predictor.augmented.kernels
        seen, late = layout.seen, float(delays_of(kernels, self.parameters)[2])
        at = (seen.t - np.where(seen.kind == 0, late, 0.0)) / fine
        last = layout.spans[seen.window, 3] * round(layout.h / fine) - 1
        k = np.clip(np.floor(at).astype(np.int64), 0, last)
        a, b = path[seen.window, k, :STATES], path[seen.window, k + 1, :STATES]
        with np.errstate(invalid="ignore"):  # a car that spun away reads nothing; it is refused
            state: State[Any] = State(*(a + (at - k)[:, None] * (b - a)).T)
            every = observe(NUMPY, model_of(kernels, self.parameters), state)
        read = np.stack(np.broadcast_arrays(*every))
        return predictor.pad(read[layout.channel, layout.reading])


def _nominal(predictor: Predictor, parameters: Array, x: Array) -> _Nominal:
    """From starts `x` (W, 7), the steering settled over known commands."""
    kernels, (held, windows) = predictor.augmented.kernels, predictor.finest[-2:]
    first = np.zeros((len(x), STATES + kernels.memory))
    first[:, :STATES] = x
    first = settle(kernels, parameters, first, held, windows)
    steps = int(predictor.layout.spans[:, 3].max()) * held.substeps
    return _Nominal(predictor, parameters, first, held, steps)


def responses(
    predictor: Predictor, parameters: Array, x: Array, inputs: Sequence[int] = range(len(INPUTS))
) -> Array:
    """(inputs, W, D, pieces) finite differences about the trajectory from the starts `x` (W, 7).

    Zero in a window whose simulation leaves the map: it is lost, whatever pushes it.
    """
    at, layout = _nominal(predictor, parameters, x), predictor.layout
    path = at.march(at.first, at.held, layout.spans[:, :3], layout.t, at.steps)
    pieces = max(1, round(at.steps * at.held.fine / PIECE))
    base = at.shown(path)
    out = np.empty((len(inputs), *base.shape, pieces))
    for piece in range(pieces):
        low, high = (k * at.steps // pieces for k in (piece, piece + 1))
        pushed = _impulses(at, path, [i for i in inputs if i < _IMPULSES], low, high)
        pushed |= {i: _aimed(at, i, low, high) for i in inputs if i >= _IMPULSES}
        for place, i in enumerate(inputs):
            with np.errstate(invalid="ignore"):  # a window that left the map
                out[place, :, :, piece] = (at.shown(pushed[i]) - base) / _SIZES[i]
    out[:, ~np.isfinite(out).all(axis=(0, 2, 3))] = 0.0
    return out


def _impulses(
    at: _Nominal, path: Array, kinds: Sequence[int], low: int, high: int
) -> dict[int, Array]:
    """Paths with an impulse of each kind in the middle of a piece."""
    layout, count, middle, fine = at.predictor.layout, len(path), (low + high) // 2, at.held.fine
    time = (high - low) * fine
    first = np.tile(path[:, middle], (len(kinds), 1))
    fast = np.maximum(path[:, middle, 3], SPEED_KINEMATIC)
    for lane, kind in enumerate(kinds):
        mine = slice(lane * count, (lane + 1) * count)
        column, scale = ((3, 1.0), (5, 1.0 / fast), (4, 1.0))[kind]
        first[mine, column] += _SIZES[kind] * time * scale
    runs = np.tile(layout.spans[:, :3], (len(kinds), 1))
    runs[:, 2] += middle // at.held.substeps
    t = np.tile(layout.t, len(kinds)) + middle * fine
    moved = at.march(first, at.held, runs, t, at.steps - middle)
    each, before = np.split(moved[:, 1:], len(kinds)), path[:, : middle + 1]
    after = zip(kinds, each, strict=True)
    return {kind: np.concatenate([before, own], axis=1) for kind, own in after}


def _aimed(at: _Nominal, kind: int, low: int, high: int) -> Array:
    """The path with one command off while it arrives within a piece."""
    predictor, channel = at.predictor, kind - _IMPULSES
    layout, sub = predictor.layout, at.held.substeps
    late = round(float(delays_of(predictor.augmented.kernels, at.parameters)[channel]) / layout.h)
    rows = layout.spans[:, 2, None] + np.arange(-late - 1, at.steps // sub + 1)[None, :]
    rows = np.clip(rows, layout.spans[:, 0, None], layout.spans[:, 1, None] - 1)
    commands = layout.commands[rows]
    commands[:, 1 + low // sub : 1 + high // sub, channel] += _SIZES[kind]
    width = commands.shape[1]
    start = np.arange(len(commands)) * width
    runs = np.column_stack([start, start + width, start + late + 1])
    held = at.held._replace(rows=commands.reshape(-1, 2))
    return at.march(at.first, held, runs, layout.t, at.steps)
