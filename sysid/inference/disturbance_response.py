"""How hidden pushes would show: the response of every reading to small inputs within a window.

Five inputs in pieces of a tenth of a second: accelerations along, across and about the car (what
the equations of motion miss; one impulse in the middle of the piece), and errors of what the two
actuators aim at (held over the piece). Finite differences of the compiled car.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.chassis import SPEED_KINEMATIC
from steerd.car_model.native.windows import (
    HeldCommands,
    delays_of,
    make_window_blocks,
    march,
    view_by_window,
)
from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.values import INTEGRATOR, first_states, paths, readings_of

Array = NDArray[np.float64]

INPUTS: tuple[str, ...] = ("accel", "lateral", "yaw", "steer", "drive")
"""Which equation an input belongs to: speed, side slip, yaw rate; steering and drive actuator."""
PIECE = 0.1
"""Length over which an input is constant [s]."""
_SIZES = (0.2, 0.2, 1.0, 0.005, 0.05)
"""Of the finite differences: [m/s^2], [m/s^2], [rad/s^2], [rad], [m/s]."""
_IMPULSES = 3
"""The first inputs are impulses on the chassis."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Derivative of the readings by the hidden inputs.

    Attributes:
        by_input: (inputs, W, D, pieces).
        piece: length of a piece [s].
    """

    by_input: Array
    piece: float


@dataclass(frozen=True, eq=False)
class _Nominal:
    """The trajectory that is pushed."""

    engine: Engine
    parameters: Array
    x: Array
    path: Array
    fine: float

    @property
    def count(self) -> int:
        return len(self.x)

    @property
    def steps(self) -> int:
        return int(self.path.shape[1]) - 1

    def shown(self, path: Array) -> Array:
        """(W, D) readings along a path."""
        engine = self.engine
        kernels, readings = engine.superset.kernels, engine.readings
        return engine.pad(readings_of(kernels, readings, self.parameters, path, self.fine))


def responses(
    engine: Engine, parameters: Array, x: Array, inputs: Sequence[int] = range(len(INPUTS))
) -> Responses:
    """Finite differences about the trajectory from the starts `x` (W, 7).

    Zero in a window whose simulation leaves the map: it is lost, whatever pushes it.
    """
    path = paths(engine.superset.kernels, engine.readings, parameters, x, engine.substeps)
    at = _Nominal(engine, parameters, x, path, engine.readings.layout.h / engine.substeps)
    pieces = max(1, round(at.steps * at.fine / PIECE))
    base = at.shown(path)
    out = np.empty((len(inputs), *base.shape, pieces))
    for piece in range(pieces):
        low, high = (k * at.steps // pieces for k in (piece, piece + 1))
        pushed = _impulses(at, [i for i in inputs if i < _IMPULSES], low, high)
        pushed |= {i: _aimed(at, i, low, high) for i in inputs if i >= _IMPULSES}
        for place, i in enumerate(inputs):
            with np.errstate(invalid="ignore"):  # a window that left the map
                out[place, :, :, piece] = (at.shown(pushed[i]) - base) / _SIZES[i]
    out[:, ~np.isfinite(out).all(axis=(0, 2, 3))] = 0.0
    return Responses(out, PIECE)


def _impulses(at: _Nominal, kinds: Sequence[int], low: int, high: int) -> dict[int, Array]:
    """Paths with an impulse of each kind in the middle of a piece."""
    engine, middle = at.engine, (low + high) // 2
    layout, count = engine.readings.layout, at.count
    time = (high - low) * at.fine
    first = np.tile(at.path[:, middle], (len(kinds), 1))
    fast = np.maximum(at.path[:, middle, 3], SPEED_KINEMATIC)
    for lane, kind in enumerate(kinds):
        mine = slice(lane * count, (lane + 1) * count)
        column, scale = ((3, 1.0), (5, 1.0 / fast), (4, 1.0))[kind]
        first[mine, column] += _SIZES[kind] * time * scale
    runs = np.tile(layout.spans[:, :3], (len(kinds), 1))
    runs[:, 2] += middle // engine.substeps
    blocks = make_window_blocks(runs, np.tile(layout.t, len(kinds)) + middle * at.fine)
    held = HeldCommands(layout.commands, layout.h, engine.substeps, INTEGRATOR)
    steps = at.steps - middle
    late = march(engine.superset.kernels, at.parameters, first, held, blocks, steps)
    moved = view_by_window(late, len(first))
    out = {}
    for lane, kind in enumerate(kinds):
        path = at.path.copy()
        path[:, middle:] = moved[lane * count : (lane + 1) * count]
        path[:, middle] = at.path[:, middle]
        out[kind] = path
    return out


def _aimed(at: _Nominal, kind: int, low: int, high: int) -> Array:
    """The path with one command off while it arrives within a piece."""
    engine, channel = at.engine, kind - _IMPULSES
    layout, sub = engine.readings.layout, engine.substeps
    late = round(float(delays_of(engine.superset.kernels, at.parameters)[channel]) / layout.h)
    rows = layout.spans[:, 2, None] + np.arange(-late - 1, at.steps // sub + 1)[None, :]
    rows = np.clip(rows, layout.spans[:, 0, None], layout.spans[:, 1, None] - 1)
    commands = layout.commands[rows]
    commands[:, 1 + low // sub : 1 + high // sub, channel] += _SIZES[kind]
    width = commands.shape[1]
    start = np.arange(at.count) * width
    runs = np.column_stack([start, start + width, start + late + 1])
    kernels = engine.superset.kernels
    first = first_states(kernels, engine.readings, at.parameters, at.x, sub)
    held = HeldCommands(commands.reshape(-1, 2), layout.h, sub, INTEGRATOR)
    path = march(kernels, at.parameters, first, held, make_window_blocks(runs, layout.t), at.steps)
    return np.ascontiguousarray(view_by_window(path, at.count))
