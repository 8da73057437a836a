"""Stepping the car through time: one step, delayed commands, whole runs."""

import math
from collections.abc import Callable, Sequence

from steerd.car_model.actuators import Actuated, actuate
from steerd.car_model.chassis import SPEED_KINEMATIC, Rates
from steerd.car_model.model import (
    Model,
    Moment,
    aim,
    bound_hooks,
    car_now,
    delays,
    link,
    memory_size,
    model_rates,
    remember,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car
from steerd.car_model.state import Arriving, Command, Delays, State

RatesAt = Callable[[State[T], float], Rates[T]]
"""Rates for a state at a fraction (0..1) of the step."""
Integrator = Callable[[RatesAt[T], State[T], float], State[T]]


def advance(state: State[T], rates: Rates[T], h: float) -> State[T]:
    """The state moved along its rates for `h` seconds; the steering angle stays."""
    moved = (at + h * rate for at, rate in zip(state, rates, strict=False))
    after: State[T] = State._make((*moved, state.steer))
    return after


def euler(rates_at: RatesAt[T], state: State[T], h: float) -> State[T]:
    """Explicit Euler, the paper's integrator (at 0.002 s)."""
    return advance(state, rates_at(state, 0.0), h)


def rk4(rates_at: RatesAt[T], state: State[T], h: float) -> State[T]:
    """The classical fourth-order Runge-Kutta step."""
    k1 = rates_at(state, 0.0)
    k2 = rates_at(advance(state, k1, 0.5 * h), 0.5)
    k3 = rates_at(advance(state, k2, 0.5 * h), 0.5)
    k4 = rates_at(advance(state, k3, h), 1.0)
    slopes = zip(k1, k2, k3, k4, strict=True)
    return advance(state, Rates(*((a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in slopes)), h)


def start(model: Model[T], state: State[T], zero: T) -> Moment[T]:
    """A first moment in `state`; `zero` is the number type's zero."""
    return Moment(state, (zero,) * memory_size(model.effects))


def move_actuators(
    ops: Ops[T], model: Model[T], state: State[T], command: Arriving[T], t: float, h: float
) -> Actuated[T]:
    """The actuators over a step within which a command arrives.

    What they do is weighed, not the commands: a servo at its slew limit turns for as long as is
    left of the step. Under a weighed command it would turn for the whole step, and where a car
    gets to would jump with its dead time.
    """
    car = car_now(ops, model, state, t)
    newer, older = (
        actuate(ops, car, state, aim(ops, model, car, each, t), h) for each in command[:2]
    )
    return Actuated(
        newer.steer + command.share.steer * (older.steer - newer.steer),
        newer.accel + command.share.speed * (older.accel - newer.accel),
    )


def step(
    ops: Ops[T],
    model: Model[T],
    moment: Moment[T],
    command: Command[T] | Arriving[T],
    t: float,
    h: float,
    integrate: Integrator[T] = rk4,
) -> Moment[T]:
    """One step of `h` seconds, `t` seconds into the run, under an already delayed command."""
    if not isinstance(command, Arriving):  # held over the whole step
        none = Command(0.0 * command.steer, 0.0 * command.speed)
        command = Arriving(command, command, none)
    out = move_actuators(ops, model, moment.state, command, t, h)
    return glide(ops, model, moment, out.steer, out.accel, t, h, integrate)


def glide(
    ops: Ops[T],
    model: Model[T],
    moment: Moment[T],
    steer: T,
    accel: T,
    t: float,
    h: float,
    integrate: Integrator[T] = rk4,
) -> Moment[T]:
    """The chassis moved for `h` seconds while its actuators end at `steer` with `accel` held.

    Used by `step`, and by simulated hardware whose motor controller brakes or coasts instead of
    following a speed.
    """
    state = moment.state
    wheel_start, memory = link(ops, model, moment.memory, state.steer)
    wheel_end, memory = link(ops, model, memory, steer)
    wheel_move = wheel_end - wheel_start

    def rates_at(at: State[T], share: float) -> Rates[T]:
        car = car_now(ops, model, at, t)
        return model_rates(ops, model, car, memory, at, wheel_start + share * wheel_move, accel)

    after = integrate(rates_at, state, h)._replace(steer=steer)
    if bound_hooks(model.effects, "remember"):
        car = car_now(ops, model, state, t)
        rest = 0.0 * accel  # the build-up of a force does not ask how hard the wheels push
        ends = (
            model.chassis.slip_angles(ops, car, state, wheel_start, rest),
            model.chassis.slip_angles(ops, car, after, wheel_end, rest),
        )
        memory = remember(ops, model, memory, after.speed, ends, h)
    return Moment(after, memory)


def stiffness_rate(car: Car[float], speed: float) -> float:
    """Bound of the fastest decay rate of yaw rate and slip [1/s] at a speed [m/s]."""
    v = max(abs(speed), SPEED_KINEMATIC)
    base = car.lf + car.lr
    front, rear = car.c_sf * GRAVITY * car.lr, car.c_sr * GRAVITY * car.lf
    yaw = car.mass * (car.lf**2 * front + car.lr**2 * rear) / (car.inertia_z * base)
    slip = (front + rear) / base
    return car.mu * (yaw + slip) / v


def _plain(value: T) -> float:
    """The number alone: a tensor's without its gradient."""
    return float(value.detach() if hasattr(value, "detach") else value)  # type: ignore[arg-type]


def arriving(commands: Sequence[Command[T]], k: int, late: Delays[T], h: float) -> Arriving[T]:
    """The commands of grid step `k`, each channel late by its dead time.

    `commands[i]` is held over step `i` (zero-order hold); before the first the first holds, after
    the last (a fit may try a negative delay) the last.
    """
    last, found = len(commands) - 1, []
    for c in range(2):
        steps = late[c] / h
        whole = math.floor(_plain(steps))
        newer, older = (commands[min(max(k - n, 0), last)][c] for n in (whole, whole + 1))
        found.append((newer, older, steps - whole))
    return Arriving(*(Command(*each) for each in zip(*found, strict=True)))


def simulate(
    ops: Ops[T],
    model: Model[T],
    first: Moment[T],
    commands: Sequence[Command[T]],
    h: float,
    integrate: Integrator[T] = rk4,
) -> list[Moment[T]]:
    """The whole run on a grid of `h` seconds: `len(commands) + 1` moments, `first` included."""
    late = delays(model)
    run = [first]
    for k in range(len(commands)):
        command = arriving(commands, k, late, h)
        run.append(step(ops, model, run[-1], command, k * h, h, integrate))
    return run
