"""Outgoing messages of the loop. Pure; `epoch_ns` maps monotonic to UNIX time."""

# Why: docs/decisions/messages-and-sessions.md#d23

from collections.abc import Iterable
from math import nan
from operator import attrgetter

from steerd.controller.lane_controller import ControlReport
from steerd.daemon.loop.findings import Finding
from steerd.daemon.loop.supervisor import Action, SupervisorMemory
from steerd.daemon.loop.transitions import SupervisorState
from steerd.estimator.state_filter import StateEstimate
from steerd.mocap_link.source import ClockKind, Pose
from steerd.steer_bus import messages as m
from steerd.steer_bus.standard import DiagnosticArray, DiagnosticStatus, KeyValue
from steerd.vesc_link.identity import AppConf, FwVersion
from steerd.vesc_link.telemetry import Imu, Values
from steerd.vesc_link.vesc import Answer, Drive

ALARM = (SupervisorState.FAULT_STOP, SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP)
"""States that are an error."""
CLOCK_KINDS = tuple(ClockKind)
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
        pose.t_valid_ns,
        pose.t_arrival_ns,
        pose.source_ticks or 0,
        -1 if pose.frame is None else pose.frame,
        CLOCK_KINDS.index(pose.clock),
        int(pose.tracking_valid and pose.live),
        *pose.position,
        *pose.quaternion,
        nan if pose.mean_error is None else pose.mean_error,
        pose.x,
        pose.y,
        pose.yaw,
        pose.height,
        pose.tilt,
        pose.rejected or "",
    )


def make_telemetry(header: m.Header, when: Answer, v: Values, uptime_ms: int) -> m.VescTelemetry:
    """A telemetry reply; what the firmware did not send is NaN or -1."""
    return m.VescTelemetry(
        header,
        when.t_sent_ns,
        when.t_received_ns,
        uptime_ms,
        int(v.erpm or 0),
        int(v.tachometer or 0),
        *[-1 if value is None else value for value in _COUNTS(v)],
        *[nan if value is None else value for value in _ELECTRICAL(v)],
    )


def make_imu(header: m.Header, when: Answer, i: Imu) -> m.VescImu:
    """An IMU reading."""
    values = [nan if value is None else value for value in _INERTIAL(i)]
    return m.VescImu(header, when.t_sent_ns, when.t_received_ns, *values)


def make_identity(
    version: FwVersion, appconf: AppConf | None, expected: bool, t_ns: int, epoch_ns: int
) -> m.VescIdentity:
    """Who the VESC is and how it stops by itself, as far as it has said."""
    return m.VescIdentity(
        m.make_header(t_ns + epoch_ns, m.BODY),
        t_ns,
        -1 if appconf is None else appconf.timeout_ms,
        int(expected),
        version.major,
        version.minor,
        nan if appconf is None else appconf.timeout_brake_current,
        version.uuid.hex() if version.uuid else "",
    )


def make_actuation(header: m.Header, drive: Drive, wire: bytes, seq: int) -> m.Actuation:
    """The bytes that were written in a tick, and their meaning."""
    steer = nan if drive.steer is None else drive.steer
    return m.Actuation(header, seq, drive.mode, steer, drive.speed, drive.current, wire)


def read_actuation(actuation: m.Actuation) -> tuple[int, float, float, float]:
    """The part of an actuation that a replay must reproduce."""
    return actuation.mode, actuation.steer, actuation.speed, actuation.brake_current_a


def make_state(
    estimate: StateEstimate | None,
    report: ControlReport | None,
    drive: Drive,
    mode: SupervisorState,
    flags: int,
    seq: int,
    t_ns: int,
    epoch_ns: int,
) -> m.StateMessage:
    """The state message of a tick; NaN where nothing is known yet."""
    r = report or _NO_REPORT
    state = estimate.state if estimate else (nan,) * 7
    sd = estimate.sd if estimate else (nan,) * 7
    return m.StateMessage(
        m.make_header(t_ns + epoch_ns, m.WORLD),
        t_ns,
        seq,
        flags,
        mode,
        *state,
        *sd,
        r.e1,
        r.e2,
        r.curvature,
        r.s,
        nan if drive.steer is None else drive.steer,
        drive.speed,
        estimate.health.pose.nis if estimate else nan,
    )


def make_transition(old: SupervisorState, new: SupervisorMemory, stamp_ns: int) -> m.Transition:
    """A change of the supervisor's state, with its reason."""
    code = f"{old.name.lower()}_{new.state.name.lower()}"
    return m.Transition(m.make_header(stamp_ns, m.BODY), old, new.state, code, new.reason)


def make_diagnostics(
    supervisor: SupervisorMemory,
    action: Action,
    waiting: str,
    findings: Iterable[Finding],
    extra: dict[str, str],
    stamp_ns: int,
) -> DiagnosticArray:
    """State, why it is so, what it waits for, warnings: for `steerd status` and for viewers."""
    warnings = [finding.text for finding in findings if finding.known]
    level = 2 if supervisor.state in ALARM else int(bool(warnings))
    values = {
        "state": supervisor.state.name,
        "reason": action.reason,
        "waiting": waiting,
        "warnings": "\n".join(warnings),
        **extra,
    }
    status = DiagnosticStatus(
        level=level,
        name="steerd: supervisor",
        message=f"{supervisor.state.name}: {action.reason}",
        hardware_id=extra.get("uuid", ""),
        values=tuple(KeyValue(key, value) for key, value in values.items()),
    )
    return DiagnosticArray(m.make_header(stamp_ns, m.BODY), (status,))
