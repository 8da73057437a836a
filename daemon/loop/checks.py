"""Checks before a car may be armed, one line per failure that says what to do; and at its launch.

After each start the car creeps until mocap, wheels and steering agree. That catches millimetres for
metres, a wrong rigid body, a wrong gear ratio, inverted steering and a body turned round, before
the car may be fast (`docs/reference/safety-requirements.md#s3.3`): by sums over the first half
metre, because single samples at walking pace are mostly noise.
"""

from collections.abc import Iterable, Iterator
from math import atan2, cos, degrees, hypot, pi, remainder, sin, tan, tau
from typing import NamedTuple

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.common.screen import show
from steerd.daemon.loop.findings import Finding, Flag, Severity
from steerd.daemon.loop.lease import Remote, valid_command
from steerd.daemon.loop.supervisor import STILL_SPEED
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput
from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.settings.thresholds import LAUNCH_DISTANCE, LAUNCH_RATIO, Thresholds
from steerd.steer_bus.messages import VescIdentity

_TOOL = "in VESC Tool: App Settings > General"


def check_vesc(vesc: VescIdentity | None, brakes: BrakeSettings) -> Iterator[str]:
    """Failures of the VESC: its identity and its timeout."""
    if vesc is None:
        return
    if not vesc.expected and brakes.uuid:
        yield f"VESC {vesc.uuid} is not the one of the car file: fix [vesc] uuid, or the port"
    elif not vesc.expected:
        yield f"VESC {vesc.uuid} is not the one this run began with: plug that in, or start anew"
    if vesc.timeout_ms < 0:
        yield "the VESC did not report its timeout (firmware before 3.55?): update its firmware"
        return
    if vesc.timeout_ms == 0:
        yield f"the VESC never times out: set Timeout to 100-200 ms {_TOOL}"
    elif vesc.timeout_ms > brakes.timeout_max_ms:
        yield (
            f"the VESC's timeout is {vesc.timeout_ms} ms, at most {brakes.timeout_max_ms} ms may be"
            f" armed: set Timeout {_TOOL}"
        )
    if not vesc.timeout_brake_current > 0.0:
        yield f"the VESC would coast on timeout: set Timeout Brake Current above 0 A {_TOOL}"


def find_failures(
    plan: RunPlan,
    vesc: VescIdentity | None,
    remote: Remote,
    now: WatchdogInput,
    findings: Iterable[Finding],
    flags: int,
    *,
    estimated: bool,
) -> Iterator[str]:
    """Pre-arm checks that fail, the cause before its consequences.

    `findings` are the watchdogs', `flags` the runner's; `estimated`: there is a sound estimate.
    """
    yield from check_vesc(vesc, plan.settings.brakes)
    if flags & Flag.UNBOUNDED:
        yield "the VESC does not take this session's speed limit: power it off and on"
    if not estimated:
        yield "an estimate: mocap must see the car for a moment, standing"
    for finding in findings:
        if finding.severity > Severity.WARN:  # it would trip an armed car
            yield finding.text
    if estimated and not plan.remote:
        yield from check_lane(now.lateral_error, now.heading_error, plan.settings.thresholds)
    elif estimated and valid_command(remote, now.t_ns) is None:
        yield "no commands from a controller: start `steerd control`, `steerd teleop` or /drive"
    if now.state is not SupervisorState.RUNNING and not abs(now.speed) < STILL_SPEED:
        yield f"the car moves at {show(now.speed, '.2f')} m/s: let it stand"


def check_lane(e1: float, e2: float, thresholds: Thresholds) -> Iterator[str]:
    """Failures of the car's place in its lane, by its lane errors [m, rad]."""
    if not abs(e1) <= thresholds.lateral_warn:
        side = "left" if e1 > 0.0 else "right"
        yield f"the car stands {show(abs(e1), '.2f')} m {side} of the path: put it on the path"
    elif not abs(e2) <= thresholds.heading_warn:
        yield f"the car points {show(degrees(e2), '+.0f')}° off the path: turn it"


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
