"""The simulated car: `car_model`'s equations driven by what a motor controller does to the wheels.

A motor controller does not only follow a speed: it also pushes with a torque, brakes against the
motion, or lets go. Torque and brake act through friction that opposes motion and never reverses
it, so a braked car comes to rest and stays there. Steps are the compiled library's.
"""

# Why: docs/decisions/vehicle-model.md#d19

import math
from collections import deque
from collections.abc import Callable
from ctypes import byref, c_char
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from math import inf
from struct import Struct
from typing import NamedTuple

from steerd.car_model.chassis import SPEED_KINEMATIC
from steerd.car_model.model import Model, delays, hooked, observe
from steerd.car_model.native import windows
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import GRAVITY
from steerd.car_model.rollout import stiffness_rate
from steerd.car_model.state import ORIGIN, Observation, State
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.steer_bus.quick_values import quick_value

Numbers = tuple[float, ...]


class Steps(NamedTuple):
    """A step and its two halves, over plain floats."""

    memory: int  # how many numbers the car remembers beside its state; all begin at zero
    # ``follow(*state, *memory, steer, speed, t)`` gives state and memory
    follow: Callable[..., Numbers]
    # Takes the same, gives the steering angle at the step's end and the acceleration
    actuate: Callable[..., Numbers]
    # ``glide(count, *state, *memory, steer_end, accel, t)`` gives state and memory, by `count`
    # shorter steps
    glide: Callable[..., Numbers]


@lru_cache(maxsize=64)
def make_steps(model: Model[float], h: float) -> Steps:
    """Steps of `h` seconds; kept, since a second car of the same make (a seed, a fault) is alike.

    Raises:
        LibraryError: the library was not built.
        ValueError: an effect is not in it.
    """
    kernels = windows.make_kernels(model.effects, model.chassis)
    size = windows.STATES + kernels.memory

    @lru_cache(maxsize=16)
    def part(count: int) -> Callable[..., Numbers]:
        return _compiled(kernels, model, "glide", size, h, count)

    return Steps(
        kernels.memory,
        _compiled(kernels, model, "follow", size, h),
        _compiled(kernels, model, "actuated", 2, h),
        lambda count, *numbers: part(count)(*numbers),
    )


def _compiled(
    kernels: windows.Kernels, model: Model[float], name: str, size: int, h: float, count: int = 1
) -> Callable[..., Numbers]:
    """A function of the library that takes state, memory and three numbers and gives `size`."""
    car = windows.car_numbers(kernels, windows.parameter_vector(model), h / count, "rk4", count)
    function, given = kernels.function(name), Struct(f"={windows.STATES + kernels.memory + 3}d")
    taken, integration = Struct(f"={size}d"), byref(car.integration)
    memory = bytearray(taken.size)
    into = (c_char * taken.size).from_buffer(memory)

    def call(*numbers: float, _alive: object = car) -> Numbers:
        function(integration, given.pack(*numbers), into)
        found = taken.unpack(memory)
        if not -inf < sum(found) < inf:
            raise ValueError(f"the simulated car's motion is no number after {numbers}")
        return found

    return call


NS = 1_000_000_000
_HISTORY = 0.5  # how far back poses are kept, beyond the pose channel's own dead time [s]


class Drive(IntEnum):
    """What the motor does."""

    SPEED = 0  # follow a wheel speed [m/s]
    FORCE = 1  # accelerate [m/s^2], against the drive train's own drag; may reverse
    BRAKE = 2  # decelerate [m/s^2] in addition to the drag, never beyond standstill; 0 is coasting


@quick_value
class Demand:
    """What the motor controller asks of the wheels."""

    drive: Drive
    value: float


_SPEED = Drive.SPEED
_V, _YAW_RATE, _SLIP = map(State._fields.index, ("speed", "yaw_rate", "slip_angle"))
COAST = Demand(Drive.BRAKE, 0.0)


@dataclass(frozen=True)
class CarSetup:
    """How the plant is stepped."""

    step_ns: int = 2_000_000  # physics step
    coast_decel: float = 0.6  # drag of the released drive train [m/s^2]
    # Random acceleration of speed [m/s^2], yaw rate [rad/s^2] and slip [rad/s], each as standard
    # deviation over one second (it grows with the root of time)
    process_noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start: State[float] = ORIGIN  # state at the beginning

    @property
    def servo_wait(self) -> float:
        """Part of the car's ``steer_delay`` that the simulated servo signal brings along [s]."""
        return 0.0


class DelayLine:
    """A signal held between changes, `initial` before the first, read `delay_ns` late."""

    def __init__(self, delay_ns: int, initial: float) -> None:
        self._delay_ns = max(0, delay_ns)
        self._now = initial
        self._newest = initial
        self._coming: deque[tuple[int, float]] = deque()  # from when [ns] each value is in force

    def push(self, t_ns: int, value: float) -> None:
        """Hold ``value`` from ``t_ns`` on; times never go back."""
        if value != self._newest:
            self._newest = value
            self._coming.append((t_ns + self._delay_ns, value))

    def mean(self, t0_ns: int, t1_ns: int) -> float:
        """Mean of the late signal over [t0, t1); later calls start at ``t1`` or after.

        As `steerd.car_model.rollout.channel_delayed`, for changes at any time.
        """
        coming = self._coming
        while coming and coming[0][0] <= t0_ns:
            self._now = coming.popleft()[1]
        if not coming or coming[0][0] >= t1_ns:
            return self._now
        area, since = 0.0, t0_ns
        while coming and coming[0][0] < t1_ns:
            t_ns, value = coming.popleft()
            area += self._now * (t_ns - since)
            self._now, since = value, t_ns
        return (area + self._now * (t1_ns - since)) / (t1_ns - t0_ns)


class SimCar:
    """The plant on a grid of ``step_ns`` from ``t_start_ns``."""

    def __init__(
        self, model: Model[float], setup: CarSetup, noise: NoiseSource, t_start_ns: int = 0
    ) -> None:
        self.model = model
        self.setup = setup
        self.t_ns = self._t_start_ns = t_start_ns  # time of `state`
        self.speed = setup.start.speed  # true speed [m/s]
        # Acceleration over the last step, along and across [m/s^2]
        self.accel_x = self.accel_y = 0.0
        self._noise = noise
        self._noisy = any(setup.process_noise)
        self._step_ns = setup.step_ns
        self._watched = "observe" in hooked(model.effects)
        h = setup.step_ns / NS
        self._h = h
        self._steps = make_steps(model, h)
        # the true state, and behind it what the effects remember
        self._numbers: Numbers = (*setup.start, *(0.0,) * self._steps.memory)
        late = delays(model)
        self._pose_delay_ns = round(late.pose * NS)
        self._steer_delay_ns = max(0, round((late.steer - setup.servo_wait) * NS))
        self._steer = DelayLine(self._steer_delay_ns, setup.start.steer)
        self._drive_delay_ns = round(late.drive * NS)
        self._value = DelayLine(self._drive_delay_ns, 0.0)
        self._mode = DelayLine(self._drive_delay_ns, float(Drive.BRAKE))
        # decay rates of yaw rate and slip go with 1/v: RK4 steps per physics step at 1 m/s
        self._substeps = h * stiffness_rate(model.car, SPEED_KINEMATIC) * SPEED_KINEMATIC / 2.0
        length = math.ceil((_HISTORY + late.pose) / h)
        self._kept = length
        self._history = [self._numbers] * length
        self._count = 0
        # What the motor controller measures [m/s]
        self.wheel_speed = self.observe_motor().wheel_speed

    def step(self, steer: float, demand: Demand) -> None:
        """One physics step under a servo angle [rad] and a demand, both still without dead time."""
        t0, t1 = self.t_ns, self.t_ns + self._step_ns
        before, speed, h = self._numbers, self.speed, self._h
        t = (t0 - self._t_start_ns) / NS
        if self._steer_delay_ns:
            self._steer.push(t0, steer)
            steer = self._steer.mean(t0, t1)
        if self._drive_delay_ns:
            demand = self._delay_demand(demand, t0, t1)
        drive, value = demand.drive, demand.value
        if drive is _SPEED and not -self._substeps < speed < self._substeps:
            after = self._steps.follow(*before, steer, value, t)
        else:
            target = value if drive is _SPEED else speed
            end, accel = self._steps.actuate(*before, steer, target, t)
            if drive is not _SPEED:
                accel = self._free_acceleration(demand)
            # more, shorter steps where the yaw mode is stiff
            count = max(1, math.ceil(self._substeps / max(abs(speed), SPEED_KINEMATIC)))
            after = self._steps.glide(count, *before, end, accel, t)
        if drive is not _SPEED and self._comes_to_rest(speed, after[_V], demand):
            after = (*after[:_V], 0.0, *after[_V + 1 :])
        if self._noisy and after[_V]:
            after = self._add_process_noise(after)
        self._numbers, self.speed = after, after[_V]
        self.wheel_speed = (
            self.observe_motor().wheel_speed
            if self._watched
            else self.speed / self.model.car.speed_gain
        )
        self.accel_x = (self.speed - speed) / h
        self.accel_y = self.speed * (after[_YAW_RATE] + (after[_SLIP] - before[_SLIP]) / h)
        self.t_ns = t1
        self._count += 1
        self._history[self._count % self._kept] = after

    def _delay_demand(self, demand: Demand, t0: int, t1: int) -> Demand:
        self._mode.push(t0, float(demand.drive))
        self._value.push(t0, demand.value)
        return Demand(Drive(int(self._mode.mean(t0, t0 + 1))), self._value.mean(t0, t1))

    def _grip(self) -> float:
        return self.model.car.mu * GRAVITY

    def _free_acceleration(self, demand: Demand) -> float:
        """Acceleration by motor and drag at the present speed, within the tyres' grip."""
        speed, value = self.speed, demand.value
        drag = self.setup.coast_decel
        if demand.drive is Drive.FORCE:
            if speed == 0.0:
                value = math.copysign(max(0.0, abs(value) - drag), value)
            else:
                value -= math.copysign(drag, speed)
            return max(-self._grip(), min(self._grip(), value))
        return -math.copysign(min(value + drag, self._grip()), speed) if speed else 0.0

    def _comes_to_rest(self, before: float, after: float, demand: Demand) -> bool:
        """Whether friction ends the motion in this step, or holds the car where it stands."""
        drag = self.setup.coast_decel + (demand.value if demand.drive is Drive.BRAKE else 0.0)
        if before * after < 0.0:
            return demand.drive is not Drive.FORCE or abs(demand.value) <= drag
        held = before == 0.0 and abs(after) <= min(drag, self._grip()) * self._h
        return held and demand.drive is Drive.BRAKE

    def _add_process_noise(self, numbers: Numbers) -> Numbers:
        noise, scale, after = self._noise, math.sqrt(self._h), list(numbers)
        for place, sd in zip((_V, _YAW_RATE, _SLIP), self.setup.process_noise, strict=True):
            after[place] += sd * scale * noise.normal()
        return tuple(after)

    @property
    def state(self) -> State[float]:
        """True state."""
        return State(*self._numbers[: windows.STATES])

    def state_at(self, t_ns: int) -> State[float]:
        """True state at a past time, straight between grid points; as far back as is kept."""
        steps = (t_ns - self._t_start_ns) / self.setup.step_ns
        oldest = max(0, self._count - self._kept + 1)
        steps = min(max(steps, oldest), self._count)
        low = int(steps)
        part = steps - low
        first = self._history[low % self._kept]
        if not part:
            return State(*first[: windows.STATES])
        second = self._history[(low + 1) % self._kept]
        pairs = zip(first[: windows.STATES], second[: windows.STATES], strict=True)
        return State(*[a + part * (b - a) for a, b in pairs])

    def observe_pose(self, t_ns: int) -> Observation[float]:
        """What cameras exposed at ``t_ns`` see: the pose, its channel's dead time ago."""
        return observe(FLOAT, self.model, self.state_at(t_ns - self._pose_delay_ns))

    def observe_motor(self) -> Observation[float]:
        """What motor controller and gyro measure now."""
        return observe(FLOAT, self.model, self.state)
