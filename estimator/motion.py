"""Propagation of a belief: the chassis' equations, exact Jacobian, one implicit step.

The linearly implicit midpoint rule (Rosenbrock's, one stage) with `A` the Jacobian of the rates:

    x+ = x + h W f(x),   F = 2 W - I = (I - h A / 2)^-1 (I + h A / 2),   W = (I - h A / 2)^-1

is of second order and stable however fast yaw rate and slip decay (about 94 / v per second for the
paper's car, which an explicit step of 10 ms no longer follows below 0.5 m/s). One evaluation of
the equations serves mean and covariance alike. The whole step is recorded once per car and chassis
and compiled (`steerd.car_model.tape`), zeros of sparse matrices left out.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.chassis import SPEED_DYNAMIC, Chassis, derivative
from steerd.car_model.ops import FLOAT, Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State
from steerd.car_model.straight_line import compiled
from steerd.car_model.tape import TAPE, Node, Tape, jacobian
from steerd.estimator.actuation import SECONDS, ActuatorMotion, History, drive
from steerd.estimator.config import FilterConfig
from steerd.estimator.kalman import Array, Belief, Kalman

SIZE = len(State._fields)
LONGEST_STEP_NS = 10_000_000
MOST_STEPS = 25
"""A gap without any measurement is divided no finer: a tick must stay cheap however long it is."""
STEEPEST = 3
"""Highest power by which the steps of a long gap grow."""
_WHEEL, _ACCEL = 6, 7
"""Columns of the inputs in the Jacobian of the rates, after the six chassis states."""
_FED = (4, 5, 0, 1)
"""Rates that wheel angle and acceleration may enter, as `implicit_solver` takes them."""

Rows = Sequence[Sequence[Any]]
"""A matrix of numbers of any kind that has arithmetic: floats, or numbers being recorded."""


class Propagation(NamedTuple):
    """A step's outcome."""

    mean: Array
    """(7,) after it."""
    transition: Array
    """(7, 7): its Jacobian by the mean before, `F`."""
    noise: Array
    """(7, 7): covariance that entered during it, `Q`."""


def slip_density(ops: Ops[T], lateral: T, speed: T) -> T:
    """Spectral density of the slip angle's unmodelled rate, from that of the lateral acceleration.

    A lateral acceleration turns the velocity by `a / v`; below `SPEED_DYNAMIC` the tyres no longer
    decide, and the divisor stays there.
    """
    slip = lateral / ops.maximum(ops.absolute(speed), SPEED_DYNAMIC)
    density: T = slip * slip
    return density


def noise_density(config: FilterConfig, speed: float, *, steered: bool = True) -> list[float]:
    """Spectral densities of the states' unmodelled rates (7,), squared units per second.

    A servo that nothing drives stays where it is.
    """
    return [
        config.position_density**2,
        config.position_density**2,
        config.yaw_density**2,
        config.longitudinal_accel_density**2,
        config.yaw_accel_density**2,
        slip_density(FLOAT, config.lateral_accel_density, speed),
        config.steer_rate_density**2 if steered else 0.0,
    ]


def implicit_solver(rows: Rows, k: Any) -> Callable[[Any, Any, Any, Any], tuple[Any, ...]]:
    """Solver of `(I - k A) z = b`; `b` in the order yaw, speed, yaw rate, slip, x, y.

    Only yaw rate and slip feed back on each other; speed stands alone; yaw, then x and y, follow by
    substitution. A test holds it against the dense
    solution, which would notice an equation that couples more.
    """
    (_, _, x_yaw, x_speed, x_r, x_slip, *_), (_, _, y_yaw, y_speed, y_r, y_slip, *_) = rows[:2]
    (_, _, _, r_speed, r_r, r_slip, *_), (_, _, _, s_speed, s_r, s_slip, *_) = rows[4:]
    p, q, s, t = 1.0 - k * r_r, k * r_slip, k * s_r, 1.0 - k * s_slip
    scale = 1.0 / (p * t - q * s)

    def solve(
        yaw: Any, speed: Any, yaw_rate: Any, slip: Any, x: Any = 0.0, y: Any = 0.0
    ) -> tuple[Any, ...]:
        u, w = yaw_rate + k * r_speed * speed, slip + k * s_speed * speed
        rate, beta = scale * (t * u + q * w), scale * (p * w + s * u)
        heading = yaw + k * rate
        return (
            x + k * (x_yaw * heading + x_speed * speed + x_slip * beta + x_r * rate),
            y + k * (y_yaw * heading + y_speed * speed + y_slip * beta + y_r * rate),
            heading,
            speed,
            rate,
            beta,
        )

    return solve


def implicit_step(
    rates: Sequence[Any], rows: Rows, state: State[Any], driven: Any, h: Any
) -> tuple[Sequence[Any], Rows]:
    """The mean `h` seconds on (7,) and its Jacobian by the mean before (7, 7).

    `rates` and `rows` are the chassis' rates and their Jacobian by chassis, wheel and acceleration.
    """
    solve = implicit_solver(rows, 0.5 * h)
    move = solve(*rates[2:])
    after = [at + h * by for at, by in zip(state, move, strict=False)]
    after[0] += h * rates[0]
    after[1] += h * rates[1]
    # F = 2 W - I, column by column; the inputs add h W B times how they follow from the state.
    gain, turn = h * driven.accel_by_speed, h * driven.wheel_by_steer
    by_accel = solve(0.0, gain, *(gain * rows[i][_ACCEL] for i in _FED))
    columns = (
        (2.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 2.0, 0.0, 0.0, 0.0, 0.0),
        solve(2.0, 0.0, 0.0, 0.0),
        [a + b for a, b in zip(solve(0.0, 2.0, 0.0, 0.0), by_accel, strict=True)],
        solve(0.0, 0.0, 2.0, 0.0),
        solve(0.0, 0.0, 0.0, 2.0),
        solve(0.0, 0.0, *(turn * rows[i][_WHEEL] for i in _FED)),
    )
    transition = [[c[i] - float(i == j) for j, c in enumerate(columns)] for i in range(SIZE - 1)]
    steering = [0.0] * (SIZE - 1) + [driven.steer_by_steer]
    return [*after, driven.steer], [*transition, steering]


def process_noise(transition: Rows, density: Sequence[Any], h: Any) -> Rows:
    """Covariance from noise of density `D` that enters all along a step, `F` growing linearly.

    `Q = integral of (I + s (F - I)) D (I + s (F - I))' h ds = h/3 (F D F' + D) + h/6 (F D + D F')`.
    """
    third = [h / 3.0 * value for value in density]
    carried = [[f * t for f, t in zip(row, third, strict=True)] for row in transition]

    def entry(i: int, j: int) -> Any:
        both = sum(a * b for a, b in zip(carried[i], transition[j], strict=True))
        return both + 0.5 * (carried[i][j] + carried[j][i]) + (third[i] if i == j else 0.0)

    return [[entry(max(i, j), min(i, j)) for j in range(SIZE)] for i in range(SIZE)]


def recorded_step(tape: Tape, car: Car[Node], chassis: Chassis) -> tuple[list[Node], list[Node]]:
    """One step: (state, driven, density, h) -> mean, transition and noise, in rows."""
    sides = [f"driven_{name}" for name in ActuatorMotion._fields[:-1]]
    names = (*State._fields, *sides, *(f"density_{i}" for i in range(SIZE)), "h")
    inputs = [tape.symbol(name) for name in names]
    state: State[Any] = State(*inputs[:SIZE])
    driven: Any = ActuatorMotion._make([*inputs[SIZE : -SIZE - 1], None])
    density, h = inputs[-SIZE - 1 : -1], inputs[-1]
    along = (*state[:-1], driven.wheel, driven.accel)
    rates = derivative(chassis, TAPE, car, state, *along[-2:])
    mean, transition = implicit_step(rates, jacobian(rates, along), state, driven, h)
    noise = process_noise(transition, density, h)
    rows = (number for matrix in (transition, noise) for row in matrix for number in row)
    return inputs, [tape.node(number) for number in (*mean, *rows)]


@lru_cache(maxsize=32)
def _program(car: Car[float], chassis: Chassis) -> Callable[..., tuple[float, ...]]:
    """A step for this car, recorded and compiled."""
    tape = Tape()
    return compiled(*recorded_step(tape, Car(*map(tape.constant, car)), chassis))


def propagate(
    car: Car[float],
    chassis: Chassis,
    state: State[float],
    driven: ActuatorMotion,
    density: Sequence[float],
    h: float,
) -> Propagation:
    """One step of `h` seconds from a mean, under what the actuators do and noise of `density`."""
    numbers = np.array(_program(car, chassis)(*state, *driven[:-1], *density, h))
    matrices = numbers[SIZE:].reshape(2, SIZE, SIZE)
    return Propagation(numbers[:SIZE], matrices[0], matrices[1])


def predict_belief(
    kalman: Kalman,
    car: Car[float],
    chassis: Chassis,
    config: FilterConfig,
    history: History,
    belief: Belief,
    start_ns: int,
    end_ns: int,
) -> Belief:
    """The belief moved from `start_ns` to `end_ns` under the commands of the history.

    The division into steps depends on the two instants alone, so that fusing the same measurements
    in any order of arrival takes the same steps. In a gap that is too long for short steps they
    grow: what is fast fades in the first ones.
    """
    span = end_ns - start_ns
    count = min(-(-span // LONGEST_STEP_NS), MOST_STEPS)
    power = 1
    while power < STEEPEST and span > LONGEST_STEP_NS * count**power:
        power += 1
    begin = start_ns
    for i in range(1, count + 1):
        end = start_ns + span * i**power // count**power
        belief = _step(kalman, car, chassis, config, history, belief, begin, end)
        begin = end
    return belief


def _step(
    kalman: Kalman,
    car: Car[float],
    chassis: Chassis,
    config: FilterConfig,
    history: History,
    belief: Belief,
    begin: int,
    end: int,
) -> Belief:
    """One step."""
    h = (end - begin) * SECONDS
    state: State[float] = State(*belief.mean.tolist())
    driven = drive(car, history, state.steer, state.speed, begin, end)
    density = noise_density(config, state.speed, steered=driven.steered)
    return kalman.predict(belief, *propagate(car, chassis, state, driven, density, h))
