"""How hidden pushes would show: the response of every reading to small inputs within a window.

Five inputs, piecewise constant: accelerations along, across and about the car (what the equations
of motion miss), and errors of what the two actuators aim at. Finite differences over many cars side
by side: one lane for each window, input and piece.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from car_model.model import Model, aim, car_now, delays, drive_actuators, observe
from car_model.numpy_ops import NUMPY
from car_model.rollout import start, step
from car_model.single_track import SPEED_KINEMATIC
from car_model.state import Command, State
from sim_gap.engine import Engine
from sysid.kernels import model_of

Array = NDArray[np.float64]

INPUTS: tuple[str, ...] = ("accel", "lateral", "yaw", "steer", "drive")
"""Which equation an input belongs to: speed, side slip, yaw rate; steering and drive actuator."""
PIECE = 0.1
"""Length over which an input is constant [s]."""
_SIZES = (0.2, 0.2, 1.0, 0.005, 0.05)
"""Of the finite differences: [m/s^2], [m/s^2], [rad/s^2], [rad], [m/s]."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Derivative of the readings by the hidden inputs.

    Attributes:
        by_input: (inputs, W, D, pieces).
        piece: length of a piece [s].
    """

    by_input: Array
    piece: float


def active_model(engine: Engine, parameters: Array) -> Model[float]:
    """The car with only those effects that do something."""
    full = model_of(engine.superset.kernels, parameters)
    kept = [
        (effect, values)
        for effect, values in zip(full.effects, full.values, strict=True)
        if values != effect.nulls
    ]
    return Model(full.car, tuple(e for e, _ in kept), tuple(v for _, v in kept))


def _held(engine: Engine, late: tuple[float, float], k: Any) -> tuple[Array, Array]:
    """Delayed commands of each window at its integration step `k`, as `rollout.channel_delayed`."""
    layout, sub = engine.readings.layout, engine.substeps
    fine = layout.h / sub
    low, high, first = layout.spans[:, 0], layout.spans[:, 1], layout.spans[:, 2]
    out = []
    for channel in range(2):
        steps = late[channel] / fine
        whole = int(np.floor(steps))
        newer = np.clip(first + (k - whole) // sub, low, high - 1)
        older = np.clip(first + (k - whole - 1) // sub, low, high - 1)
        new, old = layout.commands[newer, channel], layout.commands[older, channel]
        out.append(new + (steps - whole) * (old - new))
    return out[0], out[1]


def _settled(engine: Engine, model: Model[Any], x: Array) -> Array:
    """Steering angle of each window's start: the known commands', and the start's own part."""
    layout, late = engine.readings.layout, delays(model)
    fine = layout.h / engine.substeps
    settle = int(layout.spans[:, 4].max()) * engine.substeps
    lags = (float(late.steer), float(late.drive))
    steer, _ = _held(engine, lags, -settle)
    state: State[Any] = State(x[:, 0], x[:, 1], x[:, 2], x[:, 3], x[:, 4], x[:, 5], steer)
    for k in range(-settle, 0):
        command = Command(*_held(engine, lags, k))
        car = car_now(NUMPY, model, state, 0.0)
        ref = aim(NUMPY, model, car, command, 0.0)
        out = drive_actuators(NUMPY, model, car, state, ref, fine)
        state = state._replace(steer=out.steer)
    return np.asarray(state.steer + x[:, 6])


def _lanes(pieces: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Input and piece of each lane; lane 0 is pushed by none."""
    kinds = np.repeat(np.arange(len(INPUTS)), pieces)
    return np.concatenate([[-1], kinds]), np.concatenate([[-1], np.tile(np.arange(pieces), 5)])


def responses(engine: Engine, parameters: Array, x: Array) -> Responses:
    """Finite differences about the trajectory from the starts `x` (W, 7)."""
    model: Model[Any] = active_model(engine, parameters)
    layout = engine.readings.layout
    fine = layout.h / engine.substeps
    steps = int(layout.spans[:, 3].max()) * engine.substeps
    pieces = max(1, round(steps * fine / PIECE))
    kind, piece = _lanes(pieces)
    seen = _march(engine, model, x, kind, piece, (steps, pieces, fine))
    by_lane = np.stack([engine.pad(_sampled(engine, model, lane, fine)) for lane in seen])
    moved = by_lane[1:] - by_lane[0]
    sizes = np.array(_SIZES)[kind[1:]]
    by_lane = moved / sizes[:, None, None]
    shaped = by_lane.reshape(len(INPUTS), pieces, *by_lane.shape[1:])
    return Responses(np.ascontiguousarray(shaped.transpose(0, 2, 3, 1)), PIECE)


def _march(
    engine: Engine,
    model: Model[Any],
    x: Array,
    kind: NDArray[np.int64],
    piece: NDArray[np.int64],
    sizes: tuple[int, int, float],
) -> Array:
    """Readings of all lanes after each step: (lanes, steps + 1, 5, W)."""
    steps, pieces, fine = sizes
    late = delays(model)
    lags = (float(late.steer), float(late.drive))
    count, lanes = len(x), len(kind)
    wide = np.tile(np.column_stack([x[:, :6], _settled(engine, model, x)]), (lanes, 1)).T
    moment = start(model, State(*(column for column in wide)), 0.0 * wide[0])
    push = np.where(kind >= 0, np.array(_SIZES)[kind], 0.0)
    seen = np.empty((steps + 1, 5, lanes, count))
    seen[0] = _observed(model, moment.state, lanes)
    for k in range(steps):
        on = np.repeat(np.where(piece == k * pieces // steps, push, 0.0), count)
        which = np.repeat(kind, count)
        steer, speed = (np.tile(c, lanes) for c in _held(engine, lags, k))
        command = Command(
            steer + np.where(which == 3, on, 0.0), speed + np.where(which == 4, on, 0.0)
        )
        moment = step(NUMPY, model, moment, command, 0.0, fine)
        moment = moment._replace(state=_pushed(moment.state, which, on * fine))
        seen[k + 1] = _observed(model, moment.state, lanes)
    return np.asarray(seen.transpose(2, 0, 1, 3))


def _pushed(state: State[Any], which: NDArray[np.int64], by: Array) -> State[Any]:
    """The state after an impulse of the lane's own kind."""
    fast = np.maximum(state.speed, SPEED_KINEMATIC)
    return state._replace(
        speed=state.speed + np.where(which == 0, by, 0.0),
        slip_angle=state.slip_angle + np.where(which == 1, by / fast, 0.0),
        yaw_rate=state.yaw_rate + np.where(which == 2, by, 0.0),
    )


def _observed(model: Model[Any], state: State[Any], lanes: int) -> Array:
    seen = observe(NUMPY, model, state)
    return np.stack([np.broadcast_to(v, state.x.shape).reshape(lanes, -1) for v in seen])


def _sampled(engine: Engine, model: Model[Any], path: Array, fine: float) -> Array:
    """(R,) rows out of one lane's readings (steps + 1, 5, W)."""
    readings = engine.readings
    late = float(delays(model).pose)
    t = readings.t - np.where(readings.channel < 3, late, 0.0)
    window = np.repeat(np.arange(readings.count), np.diff(readings.layout.bounds))
    at = np.clip(t / fine, 0.0, len(path) - 1.0)
    low = np.minimum(at.astype(np.int64), len(path) - 2)
    a = path[low, readings.channel, window]
    b = path[low + 1, readings.channel, window]
    sampled: Array = a + (at - low) * (b - a)
    return sampled
