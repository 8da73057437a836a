"""Pre-arm checks: each yields one line per failure, which says what to do."""

from collections.abc import Iterable, Iterator
from math import degrees

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.common.screen import show
from steerd.daemon.loop.findings import Finding, Flag, Severity
from steerd.daemon.loop.lease import Remote, valid_command
from steerd.daemon.loop.supervisor import STILL_SPEED
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput
from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.settings.thresholds import Thresholds
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
