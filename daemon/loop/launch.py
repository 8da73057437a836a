"""First-launch window: after each start the car creeps until mocap, wheels and steering agree.

Catches millimetres for metres, a wrong rigid body, a wrong gear ratio, inverted steering and a body
turned round, before the car may be fast (`docs/reference/safety-requirements.md#s3.3`). Pure: sums
over the first half metre, because single samples at walking pace are mostly noise.
"""

from math import atan2, cos, degrees, hypot, pi, remainder, sin, tan, tau
from typing import NamedTuple

from steerd.daemon.settings.thresholds import LAUNCH_DISTANCE, LAUNCH_RATIO

JUDGE_DISTANCE = 0.25  # [m] by wheels or mocap; shorter, mocap's delay alone spoils the ratio
TURN_EXPECTED, TURN_MEASURED = 0.10, 0.03  # [rad] turned before the sign of steering is judged
HEADING_MAX = pi / 6  # [rad] between yaw and travel


class LaunchInput(NamedTuple):
    """One tick while RUNNING: mocap pose [m, rad], wheel speed [m/s], steering angle [rad]."""

    t_ns: int
    x: float
    y: float
    yaw: float
    wheel_speed: float
    steer: float


class LaunchState(NamedTuple):
    """Sums over the launch so far; distances [m], angles [rad]."""

    last: LaunchInput
    x0: float
    y0: float
    travelled: float = 0.0
    expected_turn: float = 0.0
    turned: float = 0.0
    forward: float = 0.0
    sideways: float = 0.0
    done: bool = False  # the checks have passed


def make_launch_state(start: LaunchInput) -> LaunchState:
    """Return the state at a start: all sums zero."""
    return LaunchState(start, start.x, start.y)


def _advance(s: LaunchState, i: LaunchInput, wheelbase: float) -> LaunchState:
    distance = i.wheel_speed * max(0, i.t_ns - s.last.t_ns) / 1e9
    dx, dy = i.x - s.last.x, i.y - s.last.y
    c, n = cos(s.last.yaw), sin(s.last.yaw)
    return s._replace(
        last=i,
        travelled=s.travelled + distance,
        expected_turn=s.expected_turn + distance * tan(i.steer) / wheelbase,
        turned=s.turned + remainder(i.yaw - s.last.yaw, tau),
        forward=s.forward + dx * c + dy * n,
        sideways=s.sideways + dy * c - dx * n,
    )


def _find_fault(s: LaunchState) -> str:
    """Return what is wrong, or an empty text."""
    by_wheels, by_mocap = abs(s.travelled), hypot(s.last.x - s.x0, s.last.y - s.y0)
    if not max(by_wheels, by_mocap) >= JUDGE_DISTANCE:
        return ""
    low, high = LAUNCH_RATIO
    if not low * by_wheels <= by_mocap <= high * by_wheels:
        return f"mocap moved {by_mocap:.2f} m, wheels {by_wheels:.2f} m: units, body or gear ratio"
    off = atan2(s.sideways, s.forward if s.travelled > 0.0 else -s.forward)
    if abs(off) > HEADING_MAX:
        return f"the car travels {degrees(off):.0f}° off its mocap heading: body forward axis"
    wrong = s.turned * s.expected_turn < 0.0
    if wrong and abs(s.expected_turn) >= TURN_EXPECTED and abs(s.turned) >= TURN_MEASURED:
        return "the car turns against its steering: servo direction, or mocap handedness"
    return ""


def step_launch(s: LaunchState, i: LaunchInput, wheelbase: float) -> tuple[LaunchState, str]:
    """One tick of the launch window, wheelbase [m]: the new sums, and what is wrong or ""."""
    if s.done:
        return s, ""
    s = _advance(s, i, wheelbase)
    wrong = _find_fault(s)
    return s._replace(done=not wrong and abs(s.travelled) >= LAUNCH_DISTANCE), wrong
