"""What goes into and comes out of `steerd.vesc_link.vesc.VescLink`: drive orders and events.

Times are monotonic nanoseconds: ``t_sent_ns`` is when the request was written and ``t_received_ns``
when the reply's first byte was read. The measurement lies between the two.
"""

from dataclasses import dataclass

from steerd.steer_bus.quick_values import quick_init
from steerd.vesc_link.commands import Command
from steerd.vesc_link.identity import AppConf, FwVersion, McConfTemp
from steerd.vesc_link.ids import CommandId
from steerd.vesc_link.packets import Reply
from steerd.vesc_link.telemetry import Imu, Values


@quick_init
@dataclass(frozen=True, slots=True)
class DriveSpeed:
    """Go at ``speed`` [m/s] with road-wheel angle ``steer`` [rad, left positive]."""

    steer: float
    speed: float


@dataclass(frozen=True, slots=True)
class DriveBrake:
    """Brake with ``current`` [A]; must be repeated. ``steer`` None leaves the servo alone."""

    steer: float | None
    current: float


@dataclass(frozen=True, slots=True)
class DriveShort:
    """Duty cycle zero: shorts the motor. The second means when brake current has no effect."""

    steer: float | None


@dataclass(frozen=True, slots=True)
class DriveRelease:
    """Motor current zero: the car coasts."""

    steer: float | None = None


@dataclass(frozen=True, slots=True)
class DriveSilent:
    """No motor command at all, so that the VESC's own timeout can strike."""

    steer: float | None = None


Drive = DriveSpeed | DriveBrake | DriveShort | DriveRelease | DriveSilent


@quick_init
@dataclass(frozen=True, slots=True)
class Stamped:
    """When a reply was requested and when it began to arrive [ns, monotonic]."""

    t_sent_ns: int
    t_received_ns: int

    @property
    def stamp_ns(self) -> int:
        """Estimate of the time of measurement: the middle."""
        return (self.t_sent_ns + self.t_received_ns) // 2


@quick_init
@dataclass(frozen=True, slots=True)
class Telemetry:
    """Motor telemetry, requested once per tick."""

    values: Values
    when: Stamped


@quick_init
@dataclass(frozen=True, slots=True)
class ImuSample:
    """IMU reading in SI units."""

    imu: Imu
    when: Stamped


@dataclass(frozen=True, slots=True)
class Uptime:
    """The VESC's own clock [ms since boot], requested once per second."""

    uptime_ms: int
    when: Stamped


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answered; ``expected`` is False when the UUID is not the one that was demanded."""

    version: FwVersion
    expected: bool
    when: Stamped


@dataclass(frozen=True, slots=True)
class AppConfRead:
    """The VESC's timeout and timeout brake current."""

    appconf: AppConf
    when: Stamped


@dataclass(frozen=True, slots=True)
class LimitsRead:
    """The limits in force in the VESC and its drive-train settings."""

    limits: McConfTemp
    when: Stamped


@dataclass(frozen=True, slots=True)
class Answer:
    """Any other reply to a request made through `VescLink.request`, acknowledgements included."""

    reply: Reply
    when: Stamped


@dataclass(frozen=True, slots=True)
class Expired:
    """A request without an answer in time."""

    command: Command
    t_sent_ns: int


@dataclass(frozen=True, slots=True)
class FaultSeen:
    """A fault code appeared; it clears by itself in the VESC and stays latched in the link."""

    code: int
    name: str
    t_received_ns: int


@dataclass(frozen=True, slots=True)
class Rebooted:
    """The VESC restarted: session limits are gone and its tachometer began anew."""

    reason: str
    t_received_ns: int


@dataclass(frozen=True, slots=True)
class Printed:
    """Text from the VESC."""

    text: str
    t_received_ns: int


@dataclass(frozen=True, slots=True)
class Unknown:
    """A valid frame that is no answer to an open request; ``reason`` says why."""

    payload: bytes
    command: CommandId | None
    reason: str
    t_received_ns: int


Event = (
    Telemetry | ImuSample | Uptime | Identity | AppConfRead | LimitsRead | Answer | Expired
    | FaultSeen | Rebooted | Printed | Unknown
)  # fmt: skip
