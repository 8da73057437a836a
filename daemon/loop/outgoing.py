"""What leaves in a tick: the order for the wire, through the limiter, and the messages. Pure.

`epoch_ns` maps monotonic to UNIX time.
"""

# Why: docs/decisions/messages-and-sessions.md#d23

from collections.abc import Callable, Mapping
from math import isfinite, nan
from operator import attrgetter

from steerd.car_model.state import Command
from steerd.controller.lane_controller import ControlReport
from steerd.controller.limits import LimiterState, Verdict, limit_order, make_limiter_state
from steerd.daemon.loop.findings import Finding
from steerd.daemon.loop.supervisor import Action, SupervisorMemory
from steerd.daemon.loop.transitions import BRAKED, MotorOutput, SteeringOutput, SupervisorState
from steerd.daemon.settings.config import BrakeSettings, Settings
from steerd.estimator.state_filter import StateEstimate
from steerd.mocap_link.source import ClockKind, Pose
from steerd.steer_bus import messages as m
from steerd.steer_bus.quick_values import quick_value
from steerd.steer_bus.standard import DiagnosticArray, DiagnosticStatus, KeyValue
from steerd.vesc_link.identity import AppConf, FwVersion
from steerd.vesc_link.scaling import as_sent
from steerd.vesc_link.telemetry import Imu, Values
from steerd.vesc_link.vesc import Answer, Drive

_DRIVEN = (MotorOutput.DRIVE, MotorOutput.RAMP_STOP)
_CURRENTS: Mapping[MotorOutput, Callable[[BrakeSettings], float]] = {
    MotorOutput.SOFT_BRAKE: attrgetter("soft_brake_current_a"),
    MotorOutput.HOLD_BRAKE: attrgetter("hold_brake_current_a"),
    MotorOutput.BRAKE: attrgetter("brake_current_a"),
    MotorOutput.ESTOP_BRAKE: attrgetter("estop_brake_current_a"),
}
_UNBRAKED = {
    MotorOutput.DUTY_ZERO: m.ActuationMode.SHORT,
    MotorOutput.RELEASE_ONCE: m.ActuationMode.RELEASE,
}
"""Ways to stop without a brake current; all that is not listed is silent."""


@quick_value
class Order:
    """What leaves in this tick."""

    drive: Drive  # for the wire
    limiter: LimiterState  # state of the output limiter after it
    # The command as sent, for filter and controller; None when the motor does not follow a speed
    command: Command[float] | None
    verdict: Verdict  # of the limiter; NOT_FINITE means that this order brakes instead


@quick_value
class TickResult:
    """Decision of one tick and its inputs."""

    order: Order  # for the wire
    old: SupervisorState  # the supervisor's state before the tick
    supervisor: SupervisorMemory  # the supervisor after it
    estimate: StateEstimate | None  # of the car's state, None before the first
    report: ControlReport | None  # of the lane keeper, None without an estimate
    findings: tuple[Finding, ...]  # of the watchdogs
    waiting: str  # what the supervisor waits for, for people
    facts: int  # bits of `Fact`


def make_order(
    settings: Settings,
    state: LimiterState,
    action: Action,
    wish: Command[float] | None,
    speed: float,
    t_ns: int,
) -> Order:
    """Make the order for an action; a wish that is missing or not finite brakes.

    Orders are rounded to what the VESC's scaling can express; `speed` is the best known [m/s].
    """
    limits, brakes, scaling = settings.limits, settings.brakes, settings.scaling
    measured = speed if isfinite(speed) else limits.speed_max
    driven = action.motor in _DRIVEN
    limited = limit_order(
        limits, state, _make_target(action, state, wish, measured), measured, action.cap, t_ns
    )
    if driven and (wish is None or limited.verdict is Verdict.NOT_FINITE):
        drive = Drive(m.ActuationMode.BRAKE, current=brakes.brake_current_a)
        return Order(drive, state, None, Verdict.NOT_FINITE if wish else Verdict.PASSED)
    if driven:
        sent = Command(*as_sent(scaling, limited.order.steer, limited.order.speed))
        drive = Drive(m.ActuationMode.SPEED, sent.steer, sent.speed)
        return Order(drive, limited.state, sent, limited.verdict)
    steer = None if action.steering is SteeringOutput.NONE else limited.order.steer
    # While no speed is commanded, the next order starts from the measured one.
    seen = Command(limited.order.steer, max(measured, 0.0))
    rolling = make_limiter_state(limits, seen, t_ns)
    if action.motor in _CURRENTS:
        drive = Drive(m.ActuationMode.BRAKE, steer, current=_CURRENTS[action.motor](brakes))
    else:
        drive = Drive(_UNBRAKED.get(action.motor, m.ActuationMode.SILENT), steer)
    return Order(drive, rolling, None, limited.verdict)


def _make_target(
    action: Action, state: LimiterState, wish: Command[float] | None, speed: float
) -> Command[float]:
    steer = state.order.steer
    if action.steering is SteeringOutput.CENTRE:
        steer = 0.0
    elif action.steering is SteeringOutput.LIVE and wish is not None:
        steer = wish.steer
    return Command(steer, wish.speed if wish is not None and action.motor in _DRIVEN else speed)


CLOCK_KINDS = tuple(ClockKind)
ALARM = (*BRAKED, SupervisorState.FAULT_LATCHED)  # states of a car that was stopped hard
_NO_REPORT = ControlReport(*(nan,) * len(ControlReport._fields))
_COUNTS = attrgetter("tachometer_abs", "fault", "status")
_ELECTRICAL = attrgetter(
    "input_voltage", "motor_current", "input_current", "duty", "temp_fet_c", "temp_motor_c",
    "d_current", "q_current", "v_d", "v_q",
)  # fmt: skip
_INERTIAL = attrgetter(
    "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "q_w", "q_x", "q_y", "q_z"
)


def make_mocap(pose: Pose, epoch_ns: int) -> m.MocapPose:
    """A pose as it came and as it was placed and judged."""
    return m.MocapPose(
        m.make_header(pose.t_valid_ns + epoch_ns, m.WORLD),
        pose.t_valid_ns, pose.t_arrival_ns, pose.source_ticks or 0,
        -1 if pose.frame is None else pose.frame, CLOCK_KINDS.index(pose.clock),
        int(pose.tracking_valid and pose.live), *pose.position, *pose.quaternion,
        nan if pose.mean_error is None else pose.mean_error,
        pose.x, pose.y, pose.yaw, pose.height, pose.tilt, pose.rejected or "",
    )  # fmt: skip


def make_telemetry(header: m.Header, when: Answer, v: Values, uptime_ms: int) -> m.VescTelemetry:
    """A telemetry reply; what the firmware did not send is NaN or -1."""
    return m.VescTelemetry(
        header, when.t_sent_ns, when.t_received_ns,
        uptime_ms, int(v.erpm or 0), int(v.tachometer or 0),
        *[-1 if value is None else value for value in _COUNTS(v)],
        *[nan if value is None else value for value in _ELECTRICAL(v)],
    )  # fmt: skip


def make_imu(header: m.Header, when: Answer, i: Imu) -> m.VescImu:
    """An IMU reading."""
    values = [nan if value is None else value for value in _INERTIAL(i)]
    return m.VescImu(header, when.t_sent_ns, when.t_received_ns, *values)


def make_identity(
    version: FwVersion, appconf: AppConf | None, expected: bool, t_ns: int, epoch_ns: int
) -> m.VescIdentity:
    """Who the VESC is and how it stops by itself, as far as it has said."""
    return m.VescIdentity(
        m.make_header(t_ns + epoch_ns, m.BODY), t_ns,
        -1 if appconf is None else appconf.timeout_ms, int(expected), version.major, version.minor,
        nan if appconf is None else appconf.timeout_brake_current,
        version.uuid.hex() if version.uuid else "",
    )  # fmt: skip


def make_actuation(header: m.Header, drive: Drive, wire: bytes, seq: int) -> m.Actuation:
    """The bytes that were written in a tick, and their meaning."""
    steer = nan if drive.steer is None else drive.steer
    return m.Actuation(header, seq, drive.mode, steer, drive.speed, drive.current, wire)


def read_actuation(actuation: m.Actuation) -> tuple[int, float, float, float]:
    """The part of an actuation that a replay must reproduce."""
    return actuation.mode, actuation.steer, actuation.speed, actuation.brake_current_a


def make_state(tick: TickResult, seq: int, t_ns: int, epoch_ns: int) -> m.StateMessage:
    """The state message of a tick; NaN where nothing is known yet."""
    estimate, drive = tick.estimate, tick.order.drive
    r = tick.report or _NO_REPORT
    state = estimate.state if estimate else (nan,) * 7
    sd = estimate.sd if estimate else (nan,) * 7
    return m.StateMessage(
        m.make_header(t_ns + epoch_ns, m.WORLD), t_ns, seq, tick.facts, tick.supervisor.state,
        *state, *sd, r.e1, r.e2, r.curvature, r.s,
        nan if drive.steer is None else drive.steer, drive.speed,
        estimate.health.pose.nis if estimate else nan,
    )  # fmt: skip


def make_transition(tick: TickResult, stamp_ns: int) -> m.Transition:
    """A change of the supervisor's state, with its reason."""
    old, new = tick.old, tick.supervisor.state
    code = f"{old.name.lower()}_{new.name.lower()}"
    return m.Transition(m.make_header(stamp_ns, m.BODY), old, new, code, tick.supervisor.reason)


def make_diagnostics(
    tick: TickResult, waiting: str, extra: dict[str, str], stamp_ns: int
) -> DiagnosticArray:
    """State, why it is so, what it waits for, warnings: for `steerd status` and for viewers."""
    state, reason = tick.supervisor.state, tick.supervisor.reason
    warnings = [finding.text for finding in tick.findings if finding.known]
    values = {"state": state.name, "reason": reason, "waiting": waiting}
    values |= {"warnings": "\n".join(warnings), **extra}
    status = DiagnosticStatus(
        level=2 if state in ALARM else int(bool(warnings)),
        name="steerd: supervisor",
        message=f"{state.name}: {reason}",
        hardware_id=extra.get("uuid", ""),
        values=tuple(KeyValue(key, value) for key, value in values.items()),
    )
    return DiagnosticArray(m.make_header(stamp_ns, m.BODY), (status,))
