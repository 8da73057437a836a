"""Watchdogs over one tick: pure functions in two tables, numbers in, findings out.

``INSTANT`` holds those that trip at once, ``TIMED`` those whose condition must hold for a while;
three more have a memory of their own. "Older than" is strict, "for so long" includes the instant.
Comparisons are written so that NaN trips. Watchdogs over single frames are in ``watchdogs_pose``;
the runner implements W8, W15, W16 and W26 to W29 (``WatchdogInput.reported``).
"""

# Why: docs/decisions/safety.md#d41

from collections.abc import Callable
from math import cos, degrees, isfinite, sin
from typing import NamedTuple

from steerd.daemon.common.screen import show
from steerd.daemon.loop.findings import Finding, Severity, make_finding, make_unknown
from steerd.daemon.loop.follow_model import Band
from steerd.daemon.loop.following import Followed, follow_span
from steerd.daemon.loop.transitions import BRAKED, DRIVING, HELD, SupervisorState
from steerd.daemon.loop.watchdogs_pose import PoseWatch, is_flapping, rejected_share
from steerd.daemon.settings.thresholds import SOFT_DECEL, Thresholds
from steerd.steer_bus.quick_values import changed, quick_value

_WARN = Severity.WARN
_BOOTED = 10  # VESC fault code: booting from a watchdog reset
SATURATED_GROWTH = 0.02  # [m] less is the noise of a car that holds its path at full lock
COMMANDED_S = 0.2  # after so long in ARMED or RUNNING telemetry must show that commands arrive


@quick_value
class WatchdogInput:
    """Measurements of one tick; ages in seconds, NaN where unknown."""

    t_ns: int  # now, monotonic
    state: SupervisorState  # the supervisor's, of the last tick
    pose: PoseWatch  # memory of the frame watchdogs
    mocap_age: float  # since the last ACCEPTED frame arrived [s]
    telemetry_age: float  # since the last good GET_VALUES [s]
    lease_age: float  # since lease and deadman were last renewed, the older one [s]
    speed: float  # best known, as the supervisor gets it [m/s]
    speed_erpm: float  # by the wheels [m/s]
    speed_mocap: float  # by mocap [m/s]
    speed_limit: float  # of the car now, launch window included [m/s]
    x: float  # position [m]
    y: float  # position [m]
    course: float  # direction of travel, yaw plus slip [rad]
    sigma_position: float  # standard deviation of the worse axis [m]
    sigma_yaw: float  # standard deviation [rad]
    covariance_ok: bool  # finite and positive definite
    lateral_error: float  # e1 [m]
    heading_error: float  # e2 [rad]
    steer_share: float  # |steer| over the limit on its side
    status: int  # status byte of GET_VALUES; bit 0 timeout, bit 1 kill switch
    fault_code: int  # of GET_VALUES
    tachometer: int  # absolute tachometer, -1 while unknown
    cell_voltage: float  # pack voltage over cells [V]
    fet_temperature: float  # [C]
    motor_temperature: float  # [C]; NaN without a sensor, which is allowed
    current_share: float  # |motor current| over its limit
    # Measured motion against what the orders ask of a car like this one
    followed: Followed = Followed()
    # Findings of the runner, the launch check and the command check
    reported: tuple[Finding, ...] = ()


Report = Callable[[Finding], None]  # takes a finding of this tick
Check = Callable[[Thresholds, WatchdogInput, Report], None]
_COMMANDED = (SupervisorState.ARMED, SupervisorState.RUNNING)
_STOPS = (SupervisorState.STOPPING, *BRAKED)


def mocap_timeout(th: Thresholds, speed: float) -> float:
    """Age [s] at which mocap is stale: at most ``mocap_blind`` metres without a pose (W1)."""
    if abs(speed) * th.mocap_longest <= th.mocap_blind:
        return th.mocap_longest
    return max(th.mocap_shortest, th.mocap_blind / abs(speed))


def is_inside(fence: tuple[tuple[float, float], ...], x: float, y: float) -> bool:
    """Whether (x, y) lies inside the polygon, by the even-odd rule; NaN is outside."""
    inside = False
    x1, y1 = fence[-1]
    for x2, y2 in fence:
        if (y1 > y) != (y2 > y) and x < x1 + (y - y1) * (x2 - x1) / (y2 - y1):
            inside = not inside
        x1, y1 = x2, y2
    return inside


def _report_measured(
    report: Report, id: str, value: float, trip: float, text: str, unknown: str
) -> None:
    """A value beyond its warning: a trip beyond its limit, or that it was never measured."""
    if not isfinite(value):
        report(make_unknown(id, unknown))
    else:
        report(make_finding(id, text, _WARN if value <= trip else None))


def _check_mocap_age(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    if i.mocap_age <= th.mocap_warn:
        return
    speed = i.speed if abs(i.speed) > abs(i.speed_erpm) else i.speed_erpm
    allowed = mocap_timeout(th, speed)
    text = f"no good frame for {i.mocap_age * 1e3:.0f} ms (limit {allowed * 1e3:.0f} ms)"
    _report_measured(report, "W1", i.mocap_age, allowed, text, "no good frame yet")


def _check_poses(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    """W2 to W5, by the counts of the frame watchdogs."""
    w = i.pose
    if w.frozen >= th.freeze_warn:
        text = f"{w.frozen} identical frames at {show(i.speed_erpm, '.2f')} m/s"
        report(make_finding("W2", text, None if w.frozen >= th.freeze_frames else _WARN))
    if w.invalid:
        text = f"{w.invalid} bad frames in a row"
        report(make_finding("W3", text, None if w.invalid >= th.invalid_frames else _WARN))
    flapping = bool(w.jump_times) and is_flapping(th, w, i.t_ns)
    if w.jumps or flapping:
        text = f"{w.jumps} jumps in a row, {len(w.jump_times)} lately"
        report(make_finding("W4", text, None if flapping or w.jumps >= th.jump_frames else _WARN))
    if w.rejections:
        share = rejected_share(th, w)
        trips = w.rejected >= th.nis_frames or share > th.nis_share
        text = f"{w.rejected} frames in a row rejected, {share:.0%} lately"
        report(make_finding("W5", text, None if trips else _WARN))


def _check_estimate(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    good = i.sigma_position <= th.sigma_position and i.sigma_yaw <= th.sigma_yaw
    if good and i.covariance_ok:
        return
    if i.covariance_ok and not (isfinite(i.sigma_position) and isfinite(i.sigma_yaw)):
        report(make_unknown("W6", "no estimate yet"))
        return
    text = f"sigma {i.sigma_position:.3f} m, {degrees(i.sigma_yaw):.1f}°"
    report(make_finding("W6", text if i.covariance_ok else "covariance not positive definite"))


def _check_vesc(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    """W7, W10 to W12, and the first threshold of W13, by the last telemetry."""
    if not i.telemetry_age <= th.telemetry_warn:
        text = f"no reply for {i.telemetry_age * 1e3:.0f} ms"
        _report_measured(report, "W7", i.telemetry_age, th.telemetry, text, "no reply yet")
    if i.status & 2:
        report(make_finding("W10", "status bit 1 is set"))
    if i.fault_code:
        text = f"fault code {i.fault_code}"
        report(make_finding("W12" if i.fault_code == _BOOTED else "W11", text))
    if i.cell_voltage < th.cell_warn:
        report(make_finding("W13", f"{show(i.cell_voltage, '.2f')} V per cell", _WARN))


def _check_temperature(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    fet, motor = i.fet_temperature, i.motor_temperature
    if not fet <= th.fet or fet > th.fet_warn:
        unknown = "the transistors' temperature is not known yet"
        _report_measured(report, "W14", fet, th.fet, f"transistors at {fet:.0f} C", unknown)
    if motor > th.motor or motor > th.motor_warn:
        text = f"motor at {show(motor, '.0f')} C"
        report(make_finding("W14", text, None if motor > th.motor else _WARN))


def _check_path(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    if i.state not in DRIVING:
        return
    lateral, heading = abs(i.lateral_error), abs(i.heading_error)
    if not lateral <= th.lateral_warn:
        text = f"{lateral:.2f} m"
        _report_measured(report, "W17", lateral, th.lateral_max, text, "no lane error")
    if not heading <= th.heading_warn:
        text = f"{degrees(heading):.0f}°"
        _report_measured(report, "W18", heading, th.heading, text, "no heading error")


def _check_fence(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    if not th.fence:
        return
    v = abs(i.speed)
    if not (isfinite(v) and isfinite(i.x) and isfinite(i.y) and isfinite(i.course)):
        report(make_unknown("W19", "where the car is is not known"))
        return
    stopping_distance = v * th.fence_delay + v * v / (2.0 * th.brake_decel) + th.fence_margin
    c, s = cos(i.course), sin(i.course)
    inside = is_inside(th.fence, i.x + stopping_distance * c, i.y + stopping_distance * s)
    warning_distance = stopping_distance + th.fence_warn
    if not inside or not is_inside(
        th.fence, i.x + warning_distance * c, i.y + warning_distance * s
    ):
        text = f"the car at ({i.x:.2f}, {i.y:.2f}) m needs {stopping_distance:.2f} m to stop"
        report(make_finding("W19", text, _WARN if inside else None))


def _check_lease(th: Thresholds, i: WatchdogInput, report: Report) -> None:
    if i.lease_age <= th.lease_warn or i.state not in HELD:
        return
    text = f"not renewed for {i.lease_age * 1e3:.0f} ms"
    _report_measured(report, "W25", i.lease_age, th.lease, text, "no operator yet")


INSTANT: tuple[Check, ...] = (
    _check_mocap_age, _check_poses, _check_estimate, _check_vesc, _check_temperature,
    _check_path, _check_fence, _check_lease,
)  # fmt: skip


class Timed(NamedTuple):
    """A watchdog whose condition must hold for a while."""

    id: str
    holds: Callable[[Thresholds, WatchdogInput], bool]
    seconds: Callable[[Thresholds, WatchdogInput], float]
    text: Callable[[WatchdogInput], str]


def _is_starved(_th: Thresholds, i: WatchdogInput) -> bool:
    return bool(i.status & 1) and i.state in _COMMANDED


def _is_fast(th: Thresholds, i: WatchdogInput) -> bool:
    if i.state not in DRIVING:
        return False
    limit = max(i.speed_limit * th.overspeed_ratio, i.speed_limit + th.overspeed_margin)
    return not (-limit <= i.speed_erpm <= limit and -limit <= i.speed_mocap <= limit)


def _is_mismatched(th: Thresholds, i: WatchdogInput) -> bool:
    off = abs(i.speed_erpm - i.speed_mocap)
    if off <= th.mismatch_speed or i.state not in DRIVING:
        return False
    larger = max(abs(i.speed_erpm), abs(i.speed_mocap))
    return not off <= th.mismatch_share * larger


def _is_blocked(th: Thresholds, i: WatchdogInput) -> bool:
    # The wheels' own speed: a filter that rejects its measurements would still report motion.
    if not i.current_share > th.blocked_current or i.state != SupervisorState.RUNNING:
        return False
    return not abs(i.speed_erpm) >= th.blocked_speed


def _describe_speeds(i: WatchdogInput) -> str:
    return f"wheels {show(i.speed_erpm, '.2f')}, mocap {show(i.speed_mocap, '.2f')} m/s"


def _describe_block(i: WatchdogInput) -> str:
    share, speed = show(i.current_share, ".0%"), show(i.speed_erpm, ".2f")
    return f"{share} of the current limit at {speed} m/s"


def _describe_followed(value: float, unit: str, band: Band) -> str:
    low, high = show(band.low, ".2f"), show(band.high, ".2f")
    return f"{show(value, '.2f')} {unit}, orders allow {low} to {high}"


TIMED: tuple[Timed, ...] = (
    Timed("W9", _is_starved, lambda *_: COMMANDED_S, lambda _: "status bit 0 stays set"),
    Timed("W13", lambda th, i: not i.cell_voltage >= th.cell, lambda th, _: th.cell_hold,
          lambda i: f"{show(i.cell_voltage, '.2f')} V per cell"),
    Timed("W17", lambda th, i: i.state in DRIVING and abs(i.lateral_error) > th.lateral,
          lambda th, _: th.lateral_hold, lambda i: f"{show(abs(i.lateral_error), '.2f')} m"),
    Timed("W20", _is_fast, lambda th, _: th.overspeed_hold, _describe_speeds),
    Timed("W21", _is_mismatched, lambda th, _: th.mismatch_hold, _describe_speeds),
    Timed("W22", _is_blocked, lambda th, _: th.blocked_hold, _describe_block),
    Timed("W30", lambda _, i: i.state in DRIVING and not i.followed.speed_excess <= 0.0,
          lambda th, i: follow_span(th, i.speed_erpm),
          lambda i: f"wheels {_describe_followed(i.followed.speed, 'm/s', i.followed.speed_band)}"),
    Timed("W31", lambda _, i: i.state in DRIVING and not i.followed.turn_excess <= 0.0,
          lambda th, i: 0.5 * follow_span(th, i.speed_mocap), lambda i: (
            f"turns at {_describe_followed(i.followed.turn_rate, 'rad/s', i.followed.turn_band)}")),
)  # fmt: skip
NEVER = -1
_NEVER_HELD = (NEVER,) * len(TIMED)


@quick_value
class WatchdogState:
    """Memory of the watchdogs between ticks; times [ns] or ``NEVER``."""

    # When the condition of each row of ``TIMED`` began to hold
    since: tuple[int, ...] = _NEVER_HELD
    # Telemetry has shown, since the car was armed, that motor commands arrive
    commanded: bool = False
    tachometer: int = -1  # the largest seen, -1 for none
    saturated_ns: int = NEVER  # when the steering reached its limit
    saturated_error: float = 0.0  # |e1| then [m]
    # The kind of stop whose effect is being watched, None for none
    stop: SupervisorState | None = None
    stop_ns: int = 0  # start of the window in which the car must slow down
    stop_speed: float = 0.0  # speed then [m/s]
    weak: int = 0  # windows of this stop in which it did not; after one, SET_DUTY 0 is next


def _step_timed(
    th: Thresholds, w: WatchdogState, i: WatchdogInput, report: Report
) -> tuple[int, ...]:
    since = list(_NEVER_HELD)
    for at, row in enumerate(TIMED):
        if not row.holds(th, i):
            continue
        began = w.since[at]
        start = since[at] = i.t_ns if began == NEVER else began
        if (i.t_ns - start) / 1e9 >= row.seconds(th, i):
            report(make_finding(row.id, row.text(i)))
    return tuple(since)


def _step_vesc(w: WatchdogState, i: WatchdogInput, report: Report) -> tuple[bool, int]:
    """W9 once telemetry has shown that commands arrive, and W12 by the tachometer."""
    timeout = bool(i.status & 1)
    if w.commanded and timeout and i.state == SupervisorState.RUNNING:
        report(make_finding("W9", "status bit 0 is set while driving"))
    if 0 <= i.tachometer < w.tachometer:
        report(make_finding("W12", f"tachometer fell from {w.tachometer} to {i.tachometer}"))
    commanded = i.state in _COMMANDED and (w.commanded or not timeout)
    return commanded, i.tachometer if i.tachometer >= 0 else w.tachometer


def _step_saturation(
    th: Thresholds, w: WatchdogState, i: WatchdogInput, report: Report
) -> tuple[int, float]:
    """W23: full lock for long while the lateral error grows."""
    if i.state not in DRIVING or i.steer_share <= th.saturated:
        return NEVER, 0.0
    error = abs(i.lateral_error)
    if w.saturated_ns == NEVER:
        return i.t_ns, error
    held = (i.t_ns - w.saturated_ns) / 1e9
    if held >= th.saturated_warn and not error <= w.saturated_error + SATURATED_GROWTH:
        text = f"at the limit for {held:.1f} s, {show(error, '.2f')} m off and growing"
        report(make_finding("W23", text, None if held >= th.saturated_hold else _WARN))
    return w.saturated_ns, w.saturated_error


def _stopping_speed(th: Thresholds, i: WatchdogInput) -> float:
    """The larger of the best known speed and the wheels' while their telemetry is new [m/s].

    The filter believes that orders are followed: the speed of a car whose motor is dead falls
    faster in its estimate than on its wheels.
    """
    best, wheels = abs(i.speed), abs(i.speed_erpm)
    return wheels if wheels > best and i.telemetry_age <= th.telemetry else best


def _step_stop(th: Thresholds, w: WatchdogState, i: WatchdogInput, report: Report) -> WatchdogState:
    """W24: during a stop the speed must fall in each window."""
    if i.state not in _STOPS:
        return w if w.stop is None and not w.weak else changed(w, stop=None, weak=0)
    speed = _stopping_speed(th, i)
    if w.stop != i.state:
        start = i.t_ns + round(th.stop_lag * 1e9)
        return changed(w, stop=i.state, stop_ns=start, stop_speed=speed, weak=0)
    seconds = (i.t_ns - w.stop_ns) / 1e9
    if seconds <= 0.0:
        return changed(w, stop_speed=speed)
    if seconds >= th.stop_window:
        plan = SOFT_DECEL if i.state == SupervisorState.STOPPING else th.brake_decel
        drop = w.stop_speed - speed
        weak = speed > th.stop_speed and not drop >= th.stop_share * plan * seconds
        w = changed(w, stop_ns=i.t_ns, stop_speed=speed, weak=w.weak + weak)
    if w.weak:
        text = f"still {show(speed, '.2f')} m/s, too little slower after {th.stop_window:.1f} s"
        report(make_finding("W24", text if w.weak == 1 else f"CUT POWER: {text}"))
    return w


def step_watchdogs(
    th: Thresholds, w: WatchdogState, i: WatchdogInput
) -> tuple[WatchdogState, tuple[Finding, ...]]:
    """The new memory, and the findings: the runner's first, then in the order of the tables."""
    found = list(i.reported)
    report = found.append
    for check in INSTANT:
        check(th, i, report)
    since = _step_timed(th, w, i, report)
    commanded, tachometer = _step_vesc(w, i, report)
    saturated_ns, saturated_error = _step_saturation(th, w, i, report)
    w = _step_stop(th, w, i, report)
    w = WatchdogState(
        since, commanded, tachometer, saturated_ns, saturated_error,
        w.stop, w.stop_ns, w.stop_speed, w.weak,
    )  # fmt: skip
    return w, tuple(found)
