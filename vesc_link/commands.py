"""Commands from host to VESC, one frozen dataclass each; `packets` encodes and decodes.

Source: `docs/reference/vesc-serial.md#v2`. SET_MCCONF and SET_APPCONF are left out on purpose:
their blobs change with the firmware and writing them is VESC Tool's work.
"""

from dataclasses import dataclass

from steerd.steer_bus.quick_values import quick_init


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


@quick_init
@dataclass(frozen=True, slots=True)
class SetErpm:
    """Speed in electrical revolutions per minute, signed."""

    erpm: float


@dataclass(frozen=True, slots=True)
class SetPos:
    """Position control [deg]."""

    pos_deg: float


@dataclass(frozen=True, slots=True)
class SetHandbrake:
    """Open-loop holding current [A]; it heats the motor (firmware 3.07)."""

    current: float


@dataclass(frozen=True, slots=True)
class SetDetect:
    """Display mode: 0 off, 1 inductance, 2 observer, 3 encoder, 4 PID position, 5 its error."""

    mode: int


@quick_init
@dataclass(frozen=True, slots=True)
class SetServoPos:
    """Servo position, 0 to 1 for 1000 to 2000 µs; does not feed the motor timeout."""

    servo_pos: float


@dataclass(frozen=True, slots=True)
class GetMcConf:
    """Ask for the motor configuration blob (layout changes with the firmware)."""


@dataclass(frozen=True, slots=True)
class GetMcConfDefault:
    """Ask for the default motor configuration blob."""


@dataclass(frozen=True, slots=True)
class GetAppConf:
    """Ask for the app configuration; its first fields are the same in every firmware."""


@dataclass(frozen=True, slots=True)
class GetAppConfDefault:
    """Ask for the default app configuration."""


@dataclass(frozen=True, slots=True)
class TerminalCommand:
    """Run a terminal command; the answer is text in asynchronous PRINT frames."""

    text: str


@dataclass(frozen=True, slots=True)
class Reboot:
    """Restart the VESC; the USB port disappears for at least 1.5 s."""


@dataclass(frozen=True, slots=True)
class Alive:
    """Keep the last motor command running. Decoded here, never sent: it defeats the watchdog."""


@dataclass(frozen=True, slots=True)
class GetDecodedPpm:
    """Ask for the decoded receiver pulse."""


@dataclass(frozen=True, slots=True)
class ForwardCan:
    """Pass a payload on to another VESC on the CAN bus; its reply comes back unwrapped."""

    can_id: int
    inner: bytes


@dataclass(frozen=True, slots=True)
class GetValuesSetup:
    """Ask for the full set-up telemetry reply (firmware 3.48)."""


@dataclass(frozen=True, slots=True)
class SetMcConfTemp:
    """Limits in RAM [ERPM, duty, W, A] (firmware 3.48).

    The wire lets the last two be left out, and they decode as None then; encoding demands them.
    """

    current_min_scale: float
    current_max_scale: float
    erpm_min: float
    erpm_max: float
    duty_min: float
    duty_max: float
    watt_min: float
    watt_max: float
    input_current_min: float | None
    input_current_max: float | None
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
    """Ask for the set-up telemetry fields in ``mask`` (firmware 3.48)."""

    mask: int


@dataclass(frozen=True, slots=True)
class PingCan:
    """Ask which CAN ids answer; blocks the VESC's command thread for up to 2.6 s."""


@dataclass(frozen=True, slots=True)
class AppDisableOutput:
    """Keep receiver and ADC apps from commanding for ``duration_ms`` (0 enable, -1 for ever)."""

    duration_ms: int
    forward_can: bool = False


@dataclass(frozen=True, slots=True)
class GetImuData:
    """Ask for the IMU fields in the 16-bit ``mask`` (firmware 3.52)."""

    mask: int


@dataclass(frozen=True, slots=True)
class SetCurrentRel:
    """Motor current as a ratio of the configured limit (firmware 3.64)."""

    ratio: float


@dataclass(frozen=True, slots=True)
class GetMcConfTemp:
    """Ask for the limits in force and the drive train's numbers (firmware 5.02)."""


@dataclass(frozen=True, slots=True)
class GetBatteryCut:
    """Ask for the battery cut-off voltages (firmware 5.03)."""


@dataclass(frozen=True, slots=True)
class GetStats:
    """Ask for the statistics in the 16-bit ``mask`` (firmware 5.03)."""

    mask: int


@dataclass(frozen=True, slots=True)
class ResetStats:
    """Restart the statistics (firmware 5.03)."""

    ack: bool = False


@dataclass(frozen=True, slots=True)
class MotorEstop:
    """Release the motor and ignore every motor command for ``duration_ms`` (firmware 6.06)."""

    duration_ms: int


Command = (
    GetFwVersion | GetValues | SetDuty | SetCurrent | SetCurrentBrake | SetErpm | SetPos
    | SetHandbrake | SetDetect | SetServoPos | GetMcConf | GetMcConfDefault | GetAppConf
    | GetAppConfDefault | TerminalCommand | Reboot | Alive | GetDecodedPpm | ForwardCan
    | GetValuesSetup | SetMcConfTemp | GetValuesSelective | GetValuesSetupSelective | PingCan
    | AppDisableOutput | GetImuData | SetCurrentRel | GetMcConfTemp | GetBatteryCut | GetStats
    | ResetStats | MotorEstop
)  # fmt: skip
