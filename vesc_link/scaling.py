"""Between SI and the VESC's units: speed and ERPM, road-wheel steer angle and servo position.

``erpm = erpm_gain * v + erpm_offset`` and ``servo_pos = servo_gain * steer + servo_offset``
(f1tenth/vesc ``vesc_ackermann``; `docs/reference/vesc-serial.md#v5.1`).
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Scaling:
    """Calibration of one car's drive train and steering.

    The defaults are those of the F1TENTH stack's ``vesc.yaml`` (f1tenth_system, humble-devel).
    """

    erpm_gain: float = 4614.0  # ERPM per m/s (``speed_to_erpm_gain``)
    erpm_offset: float = 0.0  # ERPM at standstill (``speed_to_erpm_offset``)
    # Servo position per rad of road-wheel angle; negative, because the servo turns right for
    # growing pulses and steer is positive left (``steering_angle_to_servo_gain``)
    servo_gain: float = -1.2135
    # Servo position straight ahead (``steering_angle_to_servo_offset``)
    servo_offset: float = 0.5304
    servo_min: float = 0.15  # lowest servo position, full left (``servo_min``)
    servo_max: float = 0.85  # highest servo position, full right (``servo_max``)
    erpm_max: float = 23250.0  # largest ERPM commanded in either direction (``speed_max``)

    def __post_init__(self) -> None:
        """Refuse a calibration that cannot be inverted or leaves the servo no room."""
        values = (self.erpm_gain, self.erpm_offset, self.servo_gain, self.servo_offset)
        if not all(map(math.isfinite, (*values, self.servo_min, self.servo_max, self.erpm_max))):
            raise ValueError("scaling holds a number that is not finite")
        if self.erpm_gain == 0 or self.servo_gain == 0:
            raise ValueError("erpm_gain and servo_gain must not be zero")
        if not 0 <= self.servo_min < self.servo_max <= 1:
            raise ValueError("servo limits must satisfy 0 <= servo_min < servo_max <= 1")
        if self.erpm_max <= 0:
            raise ValueError("erpm_max must be positive")


F1TENTH = Scaling()
SERVO_STEPS = 1000
"""Servo positions travel as thousandths (SET_SERVO_POS)."""


def speed_to_erpm(scaling: Scaling, speed: float) -> float:
    """ERPM for a speed [m/s], clamped to ``erpm_max``.

    Raises:
        ValueError: the speed is NaN or infinite.
    """
    if not -math.inf < speed < math.inf:
        raise ValueError(f"speed {speed} is no command")
    erpm, most = scaling.erpm_gain * speed + scaling.erpm_offset, scaling.erpm_max
    return most if erpm > most else -most if erpm < -most else erpm


def erpm_to_speed(scaling: Scaling, erpm: float) -> float:
    """Speed [m/s] at an ERPM."""
    return (erpm - scaling.erpm_offset) / scaling.erpm_gain


def steer_to_servo_pos(scaling: Scaling, steer: float) -> float:
    """Servo position for a road-wheel angle [rad, left positive], clamped to the servo's limits.

    Raises:
        ValueError: the angle is NaN or infinite.
    """
    if not -math.inf < steer < math.inf:
        raise ValueError(f"steer {steer} is no command")
    pos = scaling.servo_gain * steer + scaling.servo_offset
    low, high = scaling.servo_min, scaling.servo_max
    return high if pos > high else low if pos < low else pos


def servo_pos_to_steer(scaling: Scaling, servo_pos: float) -> float:
    """Road-wheel angle [rad, left positive] at a servo position."""
    return (servo_pos - scaling.servo_offset) / scaling.servo_gain


def as_sent(scaling: Scaling, steer: float, speed: float) -> tuple[float, float]:
    """The angle [rad] and speed [m/s] that a VESC makes of a command: whole servo and ERPM steps.

    A servo step is 0.8 mrad. Held through a turn, the difference from what was meant drifts
    centimetres in seconds, so filter and recording take what was sent.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    servo_pos = math.floor(steer_to_servo_pos(scaling, steer) * SERVO_STEPS + 0.5) / SERVO_STEPS
    erpm = math.floor(speed_to_erpm(scaling, speed) + 0.5)
    return servo_pos_to_steer(scaling, servo_pos), erpm_to_speed(scaling, erpm)


def steer_limits(scaling: Scaling) -> tuple[float, float]:
    """Rightmost (negative) and leftmost (positive) road-wheel angle [rad].

    They differ in size unless the servo's centre is in the middle of its range: with the F1TENTH
    numbers 15.09° right and 17.96° left.
    """
    ends = (
        servo_pos_to_steer(scaling, scaling.servo_min),
        servo_pos_to_steer(scaling, scaling.servo_max),
    )
    return min(ends), max(ends)
