"""One cell of the fault matrix: a fault, a phase, what the bytes and the floor say about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf

from steerd.daemon.assembly.build import NS
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus.messages import RequestKind
from tests.safety.catalogue import FAULT_CASES, FaultCase, Must
from tests.safety.judge import (
    Effort,
    MotorFrame,
    count_drive_frames,
    distance_driven,
    find_stop,
    read_motor_frames,
    stopping_distance,
)
from tests.safety.rig import MS, PHASES, Rig, at_phase, twin

TICK = 0.011  # one period and 1 ms: what a detected fault needs to reach the wire
WATCH_S, LONGEST_S, STANDING_S, COLD_S = 2.0, 9.0, 1.5, 6.0
STOP_ASKED_NS = 500 * MS
SOFT_DECEL, HARD_DECEL = 1.5, 3.5
SLACK_M = 0.06
SPEED_LAG_S = 0.1  # how far a VESC's speed loop stays behind the ramp
LAUNCH_M = 0.80  # the launch window of 0.5 m, and a stop from 0.5 m/s after up to 0.3 s
UPWARD = {SupervisorState.SELF_TEST, SupervisorState.ARMED, SupervisorState.RUNNING}
MOVING = ("P4", "P5", "P6", "P7", "P8")


def list_cells() -> list[tuple[str, str]]:
    """Every cell as (fault, phase); a fault from the start (P0) where it must change something."""
    return [
        (fault_case.code, phase)
        for fault_case in FAULT_CASES
        for phase in PHASES
        if phase != "P0" or fault_case.cold or fault_case.must is Must.LIVE_ON
    ]


@dataclass(frozen=True)
class Outcome:
    code: str
    phase: str
    stop_s: float  # from the fault to the first stop byte; inf if none came
    distance_m: float  # driven from the fault to rest
    allowed_m: float
    off_m: float  # largest true distance from the path
    states: tuple[SupervisorState, ...]  # that followed, in order
    reasons: tuple[str, ...]  # why each of them
    wrong: tuple[str, ...] = ()  # verdicts that failed, as text; empty for a good cell


@dataclass(frozen=True)
class Facts:
    """All that the judges of a cell look at: the drive, its bytes since the fault, its outcome."""

    rig: Rig
    fault_case: FaultCase
    must: Must
    frames: Sequence[MotorFrame]
    seen: Outcome
    bound_s: float
    reported_s: float

    def rearmed(self) -> bool:
        """Whether the only step up is the end of a stop that the operator requested for."""
        wanted = self.fault_case.asks_stop or self.fault_case.rearms
        requested = self.seen.phase == "P7" or wanted or self.must is Must.LIVE_ON
        return requested and set(self.seen.states) & UPWARD == {SupervisorState.ARMED}


def run_cell(fault_case: FaultCase, phase: str, *, adapting: bool = False) -> Outcome:
    """Bring a fault about in a phase and judge what follows, with or without `--adapt`."""
    rig = twin(at_phase(phase, adapting))
    rig.propose_ns = min(rig.propose_ns, rig.t_ns + 100 * MS)
    seen = len(rig.notes.transitions)
    rig.track.clear()
    t_fault = rig.t_ns
    fault_case.begin(rig)
    if phase == "P0":
        drive_cold(rig, fault_case)
    else:
        drive_on(rig, fault_case, phase, t_fault)
    return judge(rig, fault_case, phase, t_fault, seen)


def drive_on(rig: Rig, fault_case: FaultCase, phase: str, t_fault: int) -> None:
    """Live with the fault until the car rests, or long enough to see that it need not."""
    requested = False
    end = t_fault + round((LONGEST_S if phase in MOVING else STANDING_S) * NS)
    while rig.t_ns < end:
        fault_case.each(rig)
        age = rig.t_ns - t_fault
        wants = fault_case.asks_stop or (
            must_now(fault_case, phase) is Must.LIVE_ON and age >= WATCH_S * NS
        )
        if phase in ("P4", "P5", "P6") and wants and not requested and age >= STOP_ASKED_NS:
            requested = True
            rig.ask(RequestKind.STOP)
        rig.step()
        if phase in MOVING and rig.resting and settled(rig):
            return


def settled(rig: Rig) -> bool:
    """Whether nothing is left to happen: half a second after motor bytes ended."""
    quiet = not rig.state.engaged or rig.state is SupervisorState.ARMED
    since_ns = rig.run.core.loop.supervisor.since_ns
    return quiet and rig.t_ns - since_ns > 500 * MS


def drive_cold(rig: Rig, fault_case: FaultCase) -> None:
    """An eager operator arms and starts whatever lets itself be armed and started."""
    end = rig.t_ns + round(COLD_S * NS)
    while rig.t_ns < end:
        fault_case.each(rig)
        if rig.state is SupervisorState.READY:
            rig.ask(RequestKind.ARM)
        elif rig.state is SupervisorState.ARMED:
            rig.ask(RequestKind.START)
        rig.step()
        if rig.state in (SupervisorState.FAULT_STOP, SupervisorState.ESTOP) and rig.resting:
            return


def must_now(fault_case: FaultCase, phase: str) -> Must:
    return fault_case.at.get(phase, fault_case.must)


def off_path(rig: Rig) -> float:
    """Largest true distance from the path [m]."""
    if rig.plan.options.path == "line":
        return max((abs(m.y) for m in rig.track), default=0.0)
    radius = float(rig.plan.options.path.split("=")[1])
    return max((abs(hypot(m.x, m.y - radius) - radius) for m in rig.track), default=0.0)


def judge(rig: Rig, fault_case: FaultCase, phase: str, t_fault: int, seen: int) -> Outcome:
    """Verdicts (a) to (h) of `docs/reference/safety-requirements.md#s6.1`."""
    frames = read_motor_frames(rig.run.world.log)
    followed = rig.notes.transitions[seen:]
    must = must_now(fault_case, phase)
    ramps = must in (Must.STOP_SOFT, Must.LIVE_ON, Must.STAY_SAFE)
    stop = find_stop(frames, t_fault, ramps=ramps)
    bound = fault_case.bound_s + TICK
    fastest = max((abs(motion.speed) for motion in rig.track), default=0.0)
    pause = (STOP_ASKED_NS / NS if fault_case.asks_stop else 0.0) + (SPEED_LAG_S if ramps else 0.0)
    decel = min(SOFT_DECEL if ramps else HARD_DECEL, fault_case.decel)
    outcome = Outcome(
        fault_case.code,
        phase,
        stop_s=(stop.t_ns - t_fault) / NS if stop else inf,
        distance_m=distance_driven(rig.track, t_fault),
        allowed_m=SLACK_M + stopping_distance(fastest, bound + fault_case.blind_s + pause, decel),
        off_m=off_path(rig),
        states=tuple(SupervisorState(message.to_state) for _, message in followed),
        reasons=tuple(message.text for _, message in followed),
    )
    since = [frame for frame in frames if frame.t_ns >= t_fault]
    reported_s = (followed[0][0] - t_fault) / NS if followed else inf
    facts = Facts(rig, fault_case, must, since, outcome, bound, reported_s)
    judges = {"P0": judge_cold, "P1": judge_standing, "P2": judge_standing, "P3": judge_standing}
    return replace(outcome, wrong=tuple(judges.get(phase, judge_moving)(facts)))


def judge_moving(f: Facts) -> Iterator[str]:
    """A car that moves, or has just been requested to stop."""
    if any(state in UPWARD for state in f.seen.states) and not f.rearmed():
        yield f"(c) went up by itself: {f.seen.states}"
    if not all(f.seen.reasons):
        yield "(e) a transition without a reason"
    if not f.fault_case.obeys and f.seen.phase != "P8":
        yield from judge_deaf(f)
        return
    if not f.rig.resting:
        yield f"(d) never came to rest: {f.rig.track[-1].speed:.2f} m/s"
    if f.seen.off_m > f.fault_case.lane_m:
        yield f"(g) left the lane by {f.seen.off_m:.2f} m"
    far = max(hypot(m.x - f.rig.track[0].x, m.y - f.rig.track[0].y) for m in f.rig.track)
    if far > f.fault_case.within_m:
        yield f"(h) got {far:.2f} m away"
    if f.seen.phase == "P8" and any(frame.effort is Effort.DRIVE for frame in f.frames):
        yield "(b) a drive frame in FAULT_STOP"
    if f.seen.phase != "P8" and f.must is Must.LIVE_ON:
        yield from judge_undisturbed(f)
        return
    if f.seen.distance_m > f.seen.allowed_m:
        yield f"(d) {f.seen.distance_m:.2f} m to rest, allowed {f.seen.allowed_m:.2f} m"
    if f.seen.phase != "P8" and f.must is not Must.STAY_SAFE:
        yield from judge_stop(f)


def judge_stop(f: Facts) -> Iterator[str]:
    ramps_already = f.seen.phase == "P7" and f.must is Must.STOP_SOFT
    if f.fault_case.wire:
        if not ramps_already and f.seen.stop_s > f.bound_s:
            yield f"(a) first stop byte after {f.seen.stop_s:.3f} s, bound {f.bound_s:.3f}"
    elif count_drive_frames(f.frames, f.rig.track[0].t_ns + 200 * MS):
        yield "(b) a drive frame after the link came back"
    wanted = SupervisorState[f.must.value]
    if ramps_already:
        if SupervisorState.ARMED in f.seen.states and not f.fault_case.rearms:
            yield "(c) armed again although something is wrong"
    elif wanted not in f.seen.states:
        yield f"(a) {wanted.name} was never entered: {f.seen.states}"
    elif f.reported_s > f.bound_s:
        yield f"(e) reported after {f.reported_s * 1e3:.0f} ms"


def judge_undisturbed(f: Facts) -> Iterator[str]:
    if {SupervisorState.FAULT_STOP, SupervisorState.ESTOP, SupervisorState.INIT} & {*f.seen.states}:
        yield f"(f) false stop: {f.seen.states} {f.seen.reasons[-1]}"
    elif f.seen.phase != "P7" and f.reported_s < WATCH_S:
        yield f"(f) false stop after {f.reported_s:.2f} s: {f.seen.reasons[0]}"


def judge_deaf(f: Facts) -> Iterator[str]:
    """A VESC that ignores commands: the daemon must notice, go on braking and say so."""
    if SupervisorState.FAULT_STOP not in f.seen.states:
        yield f"(a) no watchdog noticed that the stop has no effect: {f.seen.states}"
    elif f.frames[-1].effort is not Effort.BRAKE:
        yield "(b) gave up braking"


def judge_standing(f: Facts) -> Iterator[str]:
    if any(frame.effort is Effort.DRIVE for frame in f.frames):
        yield "(b) a drive frame while not running"
    if f.seen.distance_m > 0.02:
        yield f"(d) moved {f.seen.distance_m:.2f} m"
    phase, states = f.seen.phase, f.seen.states
    if SupervisorState.RUNNING in states or (phase != "P2" and set(states) & UPWARD):
        yield f"(c) went up by itself: {states}"
    healthy = SupervisorState.READY if phase == "P1" else SupervisorState.ARMED
    now, red = f.rig.state, f.fault_case.cold == "red" and phase not in f.fault_case.unseen
    if red and now is healthy:
        yield f"(a) {now.name} in spite of it"
    if f.must is Must.LIVE_ON and now is not healthy:
        yield f"(f) {now.name} instead of {healthy.name}: {f.seen.reasons[-1:]}"


def judge_cold(f: Facts) -> Iterator[str]:
    """An operator who arms and starts with the fault there from the beginning."""
    states = f.seen.states
    driven = SupervisorState.RUNNING in states
    match f.fault_case.cold:
        case "red":
            if SupervisorState.ARMED in states:
                yield f"(a) armed in spite of it: {states}"
        case "launch":
            if f.seen.distance_m > LAUNCH_M:
                yield f"(d) {f.seen.distance_m:.2f} m before the launch checks stopped it"
            if driven and SupervisorState.FAULT_STOP not in states:
                yield f"(a) the launch checks let it pass: {states}"
        case _ if f.must is Must.LIVE_ON:
            if not driven or SupervisorState.FAULT_STOP in states:
                yield f"(f) cannot drive: {states} {f.seen.reasons[-1:]}"
    if f.fault_case.obeys and f.seen.off_m > f.fault_case.lane_m:
        yield f"(g) left the lane by {f.seen.off_m:.2f} m"
