"""Thresholds that floats represent exactly, and looks at the watchdogs with them."""

from math import inf, nextafter

from steerd.daemon.loop.findings import Severity
from steerd.daemon.loop.watchdogs import WatchdogState, step_watchdogs
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.calm import CALM

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
WARN, SOFT, HARD, KILL = Severity


def up(value):
    return nextafter(value, inf)


def down(value):
    return nextafter(value, -inf)


def look(th=TH, memory=None, **changes):
    return step_watchdogs(th, memory or WatchdogState(), changed(CALM, **changes))[1]


def brief(findings):
    return [(f.id, f.severity) for f in findings]


def hold(seconds, th=TH, **changes):
    """Findings of the first and of the last of two ticks so many seconds apart."""
    memory, first = step_watchdogs(th, WatchdogState(), changed(CALM, **changes))
    end = CALM.t_ns + round(seconds * S)
    return brief(first), brief(look(th, memory, **{**changes, "t_ns": end}))
