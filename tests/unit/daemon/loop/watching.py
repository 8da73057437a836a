"""Calm driving, thresholds that floats represent exactly, and looks at the watchdogs with them."""

from math import inf, nextafter

from steerd.daemon.loop.outgoing import make_mocap
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput, WatchdogState, step_watchdogs
from steerd.daemon.loop.watchdogs_pose import PoseWatch
from steerd.daemon.settings.thresholds import Thresholds
from steerd.mocap_link.source import Pose
from steerd.steer_bus.quick_values import changed

CALM = WatchdogInput(
    t_ns=10**9, state=SupervisorState.RUNNING, pose=PoseWatch(), mocap_age=0.0, telemetry_age=0.0,
    lease_age=0.0, speed=1.5, speed_erpm=1.5, speed_mocap=1.5, speed_limit=2.0, x=0.0, y=0.0,
    course=0.0, sigma_position=0.01, sigma_yaw=0.01, covariance_ok=True, lateral_error=0.0,
    heading_error=0.0, steer_share=0.0, status=0, fault_code=0, tachometer=-1, cell_voltage=3.9,
    fet_temperature=40.0, motor_temperature=40.0, current_share=0.1,
)  # fmt: skip
"""Measurements of calm driving, in which no watchdog has a finding."""

# Binary fractions, so that "exactly at the threshold" is exact.
TH = Thresholds(
    mocap_warn=0.03125, mocap_blind=0.25, mocap_shortest=0.046875, mocap_longest=0.125,
    sigma_position=0.125, sigma_yaw=0.125, telemetry_warn=0.0625, telemetry=0.09375,
    cell_warn=3.5, cell=3.25, cell_hold=0.5, fet_warn=75.0, fet=85.0, motor_warn=80.0, motor=95.0,
    lateral_warn=0.1875, lateral=0.3125, lateral_hold=0.125, lateral_max=0.5,
    heading_warn=0.5, heading=0.75, fence_warn=0.5, fence_delay=0.125, fence_margin=0.125,
    overspeed_ratio=1.125, overspeed_margin=0.125, overspeed_hold=0.0625,
    mismatch_speed=0.5, mismatch_share=0.25, mismatch_hold=0.1875,
    blocked_current=0.5, blocked_speed=0.0625, blocked_hold=1.0,
    saturated=0.984375, saturated_warn=0.5, saturated_hold=1.0,
    brake_decel=4.0, stop_share=0.5, stop_lag=0.125, stop_window=0.25, stop_speed=0.125,
    lease_warn=0.125, lease=0.25, follow_hold=0.0625, follow_distance=0.125,
)  # fmt: skip
S = 10**9


def up(value):
    return nextafter(value, inf)


def down(value):
    return nextafter(value, -inf)


def step(memory=None, th=TH, **changes):
    """The memory and the findings after a tick of calm driving, but for the changes."""
    return step_watchdogs(th, memory or WatchdogState(), changed(CALM, **changes))


def look(th=TH, memory=None, **changes):
    return step(memory, th, **changes)[1]


def brief(findings):
    return [(f.id, f.severity) for f in findings]


def after(seconds, th=TH, **changes):
    """Findings of a tick; the second of two so many seconds apart, if any."""
    memory, found = step(None, th, **changes)
    end = CALM.t_ns + round(seconds * S)
    return look(th, memory, **{**changes, "t_ns": end}) if seconds else found


def seen(t_ns, place, yaw=0.0, *, turn=(1.0, 0.0, 0.0, 0.0), number=None, rejected=None, **more):
    """A pose of mocap as the loop gets it, valid as it arrives; `place` is x, y and height."""
    x, y, height = place
    sent = Pose(
        "car", number, None, None, t_ns, place, turn, t_valid_ns=t_ns, x=x, y=y, yaw=yaw,
        height=height, tilt=0.0, rejected=rejected, **more,
    )  # fmt: skip
    return make_mocap(sent, 0)
