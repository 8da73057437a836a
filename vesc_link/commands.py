"""Commands from host to VESC, one frozen dataclass each; `packets` encodes and decodes.

Behind the type of a field stand its code and scale on the wire (`wire.Field`).
They are what the client sends, and what the simulated VESC takes besides: ALIVE and REBOOT.
Source: `docs/reference/vesc-serial.md#v2`.
"""

from dataclasses import dataclass
from typing import Annotated

from steerd.steer_bus.quick_values import quick_value


@dataclass(frozen=True, slots=True)
class GetFwVersion:
    """Ask for firmware version, hardware name and UUID."""


@dataclass(frozen=True, slots=True)
class GetValues:
    """Ask for the full telemetry reply."""


@dataclass(frozen=True, slots=True)
class SetDuty:
    """Duty cycle, -1 to 1."""

    duty: Annotated[float, "i", 1e5]


@dataclass(frozen=True, slots=True)
class SetCurrent:
    """Motor current [A]; negative is reverse torque, zero releases the motor."""

    current: Annotated[float, "i", 1e3]


@dataclass(frozen=True, slots=True)
class SetCurrentBrake:
    """Brake current [A], against the motion in either direction."""

    current: Annotated[float, "i", 1e3]


@quick_value
class SetErpm:
    """Speed in electrical revolutions per minute, signed."""

    erpm: Annotated[float, "i", 1e0]


@quick_value
class SetServoPos:
    """Servo position, 0 to 1 for 1000 to 2000 µs; does not feed the motor timeout."""

    servo_pos: Annotated[float, "h", 1e3]


@dataclass(frozen=True, slots=True)
class GetAppConf:
    """Ask for the app configuration; its first fields are the same in every firmware."""


@dataclass(frozen=True, slots=True)
class Reboot:
    """Restart the VESC; the USB port disappears for at least 1.5 s."""


@dataclass(frozen=True, slots=True)
class Alive:
    """Keep the last motor command running. Decoded here, never sent: it defeats the watchdog."""


Single = Annotated[float, "f"]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits [ERPM, duty, W, A] in the order of the wire; scales are shares of its own currents."""

    current_min_scale: Single
    current_max_scale: Single
    erpm_min: Single
    erpm_max: Single
    duty_min: Single
    duty_max: Single
    watt_min: Single
    watt_max: Single
    input_current_min: Single
    input_current_max: Single


@dataclass(frozen=True, slots=True)
class SetMcConfTemp(Limits):
    """Limits in RAM (firmware 3.48)."""

    store: Annotated[bool, "?"] = False
    forward_can: Annotated[bool, "?"] = False
    ack: Annotated[bool, "?"] = True
    divide_by_controllers: Annotated[bool, "?"] = False


@dataclass(frozen=True, slots=True)
class GetValuesSelective:
    """Ask for the telemetry fields in ``mask`` (firmware 3.48)."""

    mask: Annotated[int, "I"]


@dataclass(frozen=True, slots=True)
class GetValuesSetupSelective:
    """Ask for the set-up telemetry fields in ``mask`` (firmware 3.48): for the VESC's own clock."""

    mask: Annotated[int, "I"]


@dataclass(frozen=True, slots=True)
class GetImuData:
    """Ask for the IMU fields in the 16-bit ``mask`` (firmware 3.52)."""

    mask: Annotated[int, "H"]


@dataclass(frozen=True, slots=True)
class GetMcConfTemp:
    """Ask for the limits in force and the drive train's numbers (firmware 5.02)."""


Command = (
    GetFwVersion | GetValues | SetDuty | SetCurrent | SetCurrentBrake | SetErpm | SetServoPos
    | GetAppConf | Reboot | Alive | SetMcConfTemp | GetValuesSelective
    | GetValuesSetupSelective | GetImuData | GetMcConfTemp
)  # fmt: skip
