"""Commands from host to VESC, one frozen dataclass each; `packets` encodes and decodes.

They are what the client sends, and what the simulated VESC takes besides: ALIVE and REBOOT.
Source: `docs/reference/vesc-serial.md#v2`.
"""

from dataclasses import dataclass

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

    duty: float


@dataclass(frozen=True, slots=True)
class SetCurrent:
    """Motor current [A]; negative is reverse torque, zero releases the motor."""

    current: float


@dataclass(frozen=True, slots=True)
class SetCurrentBrake:
    """Brake current [A], against the motion in either direction."""

    current: float


@quick_value
class SetErpm:
    """Speed in electrical revolutions per minute, signed."""

    erpm: float


@quick_value
class SetServoPos:
    """Servo position, 0 to 1 for 1000 to 2000 µs; does not feed the motor timeout."""

    servo_pos: float


@dataclass(frozen=True, slots=True)
class GetAppConf:
    """Ask for the app configuration; its first fields are the same in every firmware."""


@dataclass(frozen=True, slots=True)
class Reboot:
    """Restart the VESC; the USB port disappears for at least 1.5 s."""


@dataclass(frozen=True, slots=True)
class Alive:
    """Keep the last motor command running. Decoded here, never sent: it defeats the watchdog."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits [ERPM, duty, W, A] in the order of the wire; scales are shares of its own currents."""

    current_min_scale: float
    current_max_scale: float
    erpm_min: float
    erpm_max: float
    duty_min: float
    duty_max: float
    watt_min: float
    watt_max: float
    input_current_min: float
    input_current_max: float


@dataclass(frozen=True, slots=True)
class SetMcConfTemp(Limits):
    """Limits in RAM (firmware 3.48)."""

    store: bool = False
    forward_can: bool = False
    ack: bool = True
    divide_by_controllers: bool = False


@dataclass(frozen=True, slots=True)
class GetValuesSelective:
    """Ask for the telemetry fields in ``mask`` (firmware 3.48)."""

    mask: int


@dataclass(frozen=True, slots=True)
class GetValuesSetupSelective:
    """Ask for the set-up telemetry fields in ``mask`` (firmware 3.48): for the VESC's own clock."""

    mask: int


@dataclass(frozen=True, slots=True)
class GetImuData:
    """Ask for the IMU fields in the 16-bit ``mask`` (firmware 3.52)."""

    mask: int


@dataclass(frozen=True, slots=True)
class GetMcConfTemp:
    """Ask for the limits in force and the drive train's numbers (firmware 5.02)."""


Command = (
    GetFwVersion | GetValues | SetDuty | SetCurrent | SetCurrentBrake | SetErpm | SetServoPos
    | GetAppConf | Reboot | Alive | SetMcConfTemp | GetValuesSelective
    | GetValuesSetupSelective | GetImuData | GetMcConfTemp
)  # fmt: skip
