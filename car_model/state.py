"""What the equations work on: state, command, observation, as tuples over the number type.

Frames are ISO 8855: world z-up; body at the centre of gravity, x forward, y left; yaw, steer and
slip positive to the left. SI units and radians throughout.
"""

from typing import Generic, NamedTuple

from steerd.car_model.ops import T


class State(NamedTuple, Generic[T]):
    """The seven states of the single-track model (CommonRoad ST, the paper's model)."""

    x: T  # CoG position in the world [m]
    y: T  # CoG position in the world [m]
    yaw: T  # heading of the body's x axis [rad], not wrapped
    speed: T  # speed of the CoG along its velocity, negative in reverse [m/s]
    yaw_rate: T  # [rad/s]
    slip_angle: T  # side-slip of the CoG: direction of travel minus yaw [rad]
    steer: T  # angle that the steering actuator holds, as road-wheel angle [rad]


class Command(NamedTuple, Generic[T]):
    """What the controller asks for, before the car's own gains and delays."""

    steer: T  # road-wheel angle asked for [rad]
    speed: T  # speed asked for [m/s], as wheel speed with the nominal gain


class Arriving(NamedTuple, Generic[T]):
    """The commands of a step within which one arrives."""

    newer: Command[T]
    older: Command[T]  # still holds for a share of the step, from 0 to 1, by channel
    share: Command[T]


class Observation(NamedTuple, Generic[T]):
    """What the instruments would read without noise."""

    x: T  # [m], world
    y: T  # [m], world
    yaw: T  # [rad]
    wheel_speed: T  # speed that the motor controller reports with the nominal gain [m/s]
    yaw_rate: T  # [rad/s]


class Delays(NamedTuple, Generic[T]):
    """Dead times of the three channels [s]."""

    steer: T
    drive: T
    pose: T


ORIGIN: State[float] = State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
