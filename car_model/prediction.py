"""The car's prediction for a filter: one implicit step with its Jacobian and its noise.

The linearly implicit midpoint rule (Rosenbrock's, one stage) with `A` the Jacobian of the rates:

    x+ = x + h W f(x),   F = 2 W - I = (I - h A / 2)^-1 (I + h A / 2),   W = (I - h A / 2)^-1

is of second order and stable however fast yaw rate and slip decay (about 94 / v per second for the
paper's car, which an explicit step of 10 ms no longer follows below 0.5 m/s). One evaluation of
the equations serves mean and covariance alike. Everything here is recorded, printed into the
compiled library (`native/filter.h` has the loops) and evaluated by the reference in `estimator`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

from steerd.car_model.actuators import actuate, references
from steerd.car_model.chassis import SPEED_DYNAMIC, Chassis, derivative
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import Command, State
from steerd.car_model.tape import TAPE, Node, Tape, apply, gradient, jacobian

SIZE = len(State._fields)
LONGEST_STEP_NS = 10_000_000
MOST_STEPS = 25
"""A gap without any measurement is divided no finer: a tick must stay cheap however long it is."""
STEEPEST = 3  # highest power by which the steps of a long gap grow
_WHEEL, _ACCEL = 6, 7
"""Columns of the inputs in the Jacobian of the rates, after the six chassis states."""
_FED = (4, 5, 0, 1)
"""Rates that wheel angle and acceleration may enter, as `implicit_solver` takes them."""
SLIP = State._fields.index("slip_angle")

Rows = Sequence[Sequence[Any]]
"""A matrix of numbers of any kind that has arithmetic: floats, or numbers being recorded."""
Record = tuple[list[Node], list[Node]]  # inputs and outputs of a program


class ActuatorMotion(NamedTuple):
    """What steering and drive did over an interval, and how that depends on where they began."""

    steer: float  # steering angle at the end [rad]
    wheel: float  # its mean over the interval [rad]
    accel: float  # mean longitudinal acceleration [m/s^2]
    steer_by_steer: float
    wheel_by_steer: float
    accel_by_speed: float
    steered: bool = True  # false while nothing drives the servo, which then holds where it is


def slip_density(ops: Ops[T], lateral: T, speed: T) -> T:
    """Spectral density of the slip angle's unmodelled rate, from that of the lateral acceleration.

    A lateral acceleration turns the velocity by `a / v`; below `SPEED_DYNAMIC` the tyres no longer
    decide, and the divisor stays there.
    """
    slip = lateral / ops.maximum(ops.absolute(speed), SPEED_DYNAMIC)
    density: T = slip * slip
    return density


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


def recorded_step(tape: Tape, car: Car[Node], chassis: Chassis) -> Record:
    """One step: (state, driven, density, h) -> mean, transition and noise, in rows.

    The density of the slip angle's rate is given as that of the lateral acceleration.
    """
    sides = [f"driven_{name}" for name in ActuatorMotion._fields[:-1]]
    names = (*State._fields, *sides, *(f"density_{i}" for i in range(SIZE)), "h")
    inputs = [tape.symbol(name) for name in names]
    state: State[Any] = State(*inputs[:SIZE])
    driven: Any = ActuatorMotion._make([*inputs[SIZE : -SIZE - 1], None])
    density, h = inputs[-SIZE - 1 : -1], inputs[-1]
    density[SLIP] = slip_density(TAPE, density[SLIP], state.speed)
    along = (*state[:-1], driven.wheel, driven.accel)
    rates = derivative(chassis, TAPE, car, state, *along[-2:])
    mean, transition = implicit_step(rates, jacobian(rates, along), state, driven, h)
    noise = process_noise(transition, density, h)
    rows = (number for matrix in (transition, noise) for row in matrix for number in row)
    return inputs, [tape.node(number) for number in (*mean, *rows)]


def recorded_tangent(tape: Tape, car: Car[Node], chassis: Chassis) -> Record:
    """(state, wheel, accel) -> the six rates, then their derivatives in rows.

    By x, y, yaw, speed, yaw rate, slip angle, wheel and acceleration; `state.steer` plays no part.
    """
    inputs = [tape.symbol(name) for name in (*State._fields, "wheel", "accel")]
    rates = derivative(chassis, TAPE, car, State(*inputs[:SIZE]), *inputs[SIZE:])
    rows = jacobian(rates, (*inputs[: SIZE - 1], *inputs[SIZE:]))
    return inputs, [tape.node(number) for row in (rates, *rows) for number in row]


GIVEN = ("steer_cmd", "steered", "speed_cmd", "driven", "speed", "h")
"""What a piece of an interval is given: orders, 1 or 0 for whether they were given, the speed at
the interval's beginning, and how long the piece is."""
SO_FAR = ("steer", "turned", "gained", "by_steer", "by_speed", "turned_by_steer")
"""What goes from piece to piece: angle, its integral, speed gained, and their derivatives."""


def recorded_piece(tape: Tape, car: Car[Node]) -> tuple[list[Node], list[Node]]:
    """`actuate` over a piece of an interval without a change of order, and its derivatives.

    Returns:
        The inputs, `GIVEN` and then `SO_FAR`, and the outputs: `SO_FAR` after the piece.
    """
    inputs = [tape.symbol(name) for name in (*GIVEN, *SO_FAR)]
    steer_cmd, steered, speed_cmd, driven, speed, h = inputs[: len(GIVEN)]
    steer, turned, gained, by_steer, by_speed, turned_by_steer = inputs[len(GIVEN) :]
    fast = speed + gained
    still: State[Any] = State(*map(tape.constant, [0.0] * 7))
    now = still._replace(speed=fast, steer=steer)
    ref = references(TAPE, car, Command(steer_cmd, speed_cmd))
    out = actuate(TAPE, car, now, ref, cast("float", h))
    (after_by_steer,) = gradient([(out.steer, 1.0)], [steer])
    (accel_by_speed,) = gradient([(out.accel, 1.0)], [fast])
    after = apply("select", steered, out.steer, steer)
    after_by_steer = apply("select", steered, after_by_steer, 1.0)
    accel = apply("select", driven, out.accel, 0.0)
    accel_by_speed = apply("select", driven, accel_by_speed, 0.0)
    half = 0.5 * h
    return inputs, [
        after,
        turned + half * (steer + after),
        gained + h * accel,
        by_steer * after_by_steer,
        by_speed * (1.0 + h * accel_by_speed),
        turned_by_steer + half * by_steer * (1.0 + after_by_steer),
    ]
