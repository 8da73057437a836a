"""Findings: of the watchdogs, with advice; of late ticks (W15); and of what the runner observes.

The latter are bits of `Tick.flags`, recorded, so that a replay has them too. Plain integers: an
IntFlag "or" takes a microsecond, and these are tested thirty times a tick.
"""

# Why: docs/decisions/safety.md#d15

from collections.abc import Iterable, Iterator
from enum import IntEnum
from typing import NamedTuple

from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.quick_values import changed, quick_value


class Severity(IntEnum):
    """The stop that a finding requires."""

    WARN = 0
    SOFT = 1  # STOPPING
    HARD = 2  # FAULT_STOP
    ESTOP = 3


class Finding(NamedTuple):
    """The report of one watchdog in one tick."""

    id: str  # of the watchdog
    severity: Severity  # of the stop that it requires
    text: str  # for people
    # Whether its number was ever measured; if not, people have nothing to look after yet
    known: bool = True


class Watchdog(NamedTuple):
    """A row of ``WATCHDOGS``: name, severity of its trip, advice for people."""

    name: str
    severity: Severity
    advice: str


_SOFT, _HARD, _ESTOP = Severity.SOFT, Severity.HARD, Severity.ESTOP
_row = Watchdog
WATCHDOGS = {
    "W1": _row("mocap stale", _HARD, "check that the cameras see the body and its network"),
    "W2": _row("mocap frozen", _HARD, "the body is hidden: look at markers and camera view"),
    "W3": _row("mocap invalid", _HARD, "look at the body in the mocap software"),
    "W4": _row("mocap jump", _HARD, "make the marker pattern unique; run steerd mocap check"),
    "W5": _row("innovation", _HARD, "pose and wheels disagree: check units, gear ratio, body"),
    "W6": _row("estimate diverged", _HARD, "check mocap rate and the filter's noise settings"),
    "W7": _row("telemetry stale", _HARD, "check the USB cable and the VESC's power"),
    "W8": _row("serial write", _HARD, "check the USB cable, then clear"),
    "W9": _row("starved", _HARD, "the VESC's timeout fired while driving: the link is too slow"),
    "W10": _row("kill switch", _ESTOP, "release the hardware switch, then reset"),
    "W11": _row("VESC fault", _HARD, "look the code up in VESC Tool; it ignores input for 0.5 s"),
    "W12": _row("VESC rebooted", _HARD, "brown-out: check battery, plug and cable"),
    "W13": _row("battery", _SOFT, "charge the battery"),
    "W14": _row("temperature", _SOFT, "let it cool down"),
    "W15": _row("loop late", _HARD, "run steerd rtcheck; allow SCHED_FIFO; close other programs"),
    "W16": _row("guardian", _SOFT, "restart steerd run"),
    "W17": _row("lateral error", _HARD, "slow down, or check gains and the path"),
    "W18": _row("heading error", _HARD, "check body forward axis and the path's direction"),
    "W19": _row("fence", _HARD, "move the car inside, or change the fence in the car file"),
    "W20": _row("overspeed", _HARD, "check erpm gain and speed limits"),
    "W21": _row("speed mismatch", _HARD, "wheels slip, or wrong body, or wrong gear ratio"),
    "W22": _row("blocked", _HARD, "free the wheels"),
    "W23": _row("steering saturated", _SOFT, "slow down, or check steering centre and gain"),
    "W24": _row("stop not effective", _HARD, "CUT POWER if the car does not slow down"),
    "W25": _row("lease or deadman", _SOFT, "check the operator's connection"),
    "W26": _row("recorder", _SOFT, "free disk space, then restart steerd run"),
    "W27": _row("gateway", _SOFT, "restart steerd run"),
    "W28": _row("clock", _HARD, "the machine was suspended: switch suspend off"),
    "W29": _row("exception", _HARD, "report this with the session file"),
    "W30": _row("speed not followed", _HARD, "check motor and gears; identify the car"),
    "W31": _row("steering not followed", _HARD, "check servo and linkage; identify the car"),
    "limiter": _row("order not finite", _HARD, "report this with the session file"),
    "launch": _row("launch check", _HARD, "run steerd mocap check"),
}


SIMULATED = {
    "W1": "simulated cameras are late when the machine is busy; --fast drives in virtual time",
    "W7": "a simulated VESC is silent when the machine is busy; --fast drives in virtual time",
    "W8": "the simulated hardware has ended, or the machine is too busy for it",
    "W9": "the machine is too busy for real time; --fast drives in virtual time",
    "W15": "the machine is too busy for real time; --fast drives in virtual time",
    "W24": "the simulated car is slower to stop than [safety] brake_decel says",
    "W28": "the machine slept: start the simulation anew",
}
"""Advice where the hardware is simulated and the usual one would mislead."""


def advise_simulation(finding: Finding) -> Finding:
    """The finding with the advice for simulated hardware."""
    advice = SIMULATED.get(finding.id)
    own = finding.text.endswith(f"; {WATCHDOGS[finding.id].advice}")
    return blame(finding, advice) if advice and own else finding


def blame(finding: Finding, why: str) -> Finding:
    """The finding of a late tick with what made it late in place of its advice."""
    text = finding.text.removesuffix(f"; {WATCHDOGS[finding.id].advice}")
    return finding._replace(text=f"{text}; {why}")


def make_unknown(id: str, what: str) -> Finding:
    """Return the finding of a watchdog whose number was never measured: no advice is known."""
    watchdog = WATCHDOGS[id]
    return Finding(id, watchdog.severity, f"{id} {watchdog.name}: {what}", known=False)


def make_finding(id: str, measured: str, severity: Severity | None = None) -> Finding:
    """Return a finding with the watchdog's own severity, or with the given one."""
    watchdog = WATCHDOGS[id]
    level = watchdog.severity if severity is None else severity
    return Finding(id, level, f"{id} {watchdog.name}: {measured}; {watchdog.advice}")


_FACT = (0, Fact.SOFT, Fact.HARD, Fact.KILLED)  # by severity


def summarise(findings: Iterable[Finding]) -> tuple[int, str]:
    """Return the supervisor's fact bits and the text of the worst trip, the first if equal."""
    bits, worst, text = 0, 0, ""
    for finding in findings:
        bits |= _FACT[finding.severity]
        if finding.severity > worst:
            worst, text = finding.severity, finding.text
    return bits, text


class Flag:
    """Bits of `Tick.flags`."""

    LINKED = 1  # serial port open
    SERIAL_FAULT = 2  # W8
    GUARDIAN_LOST = 4  # W16
    RECORDER_LOST = 8  # W26
    GATEWAY_LOST = 16  # W27
    EXCEPTION = 32  # W29
    SUSPENDED = 64  # W28; for one tick
    REBOOTED = 128  # W12; for one tick
    MOCAP_REFUSED = 256  # the mocap source is not the configured one
    QUIT = 512  # a first stop signal
    ABORT = 1024  # a second stop signal
    GUARDIAN_TRIPPED = 2048  # W15
    UNBOUNDED = 4096  # the VESC did not take the session's limits
    STALLED = 8192  # the host took the processor away; for one tick
    ALL_LATE = 16384  # every process stood still at once; for one tick
    ALONE_LATE = 32768  # the tick was late, the other processes were not; for one tick


def merge_requests(pending: int, flags: int, state: SupervisorState, *, starts: bool) -> int:
    """Requests of this tick: of operators, of stop signals, and of a run that `starts` by itself.

    Such a run arms and starts once without an operator, and has not yet.
    """
    requests = pending
    if flags & Flag.QUIT:
        requests |= Fact.DISARM
    if flags & Flag.ABORT:
        requests |= Fact.ABORT
    if starts and not flags & (Flag.QUIT | Flag.ABORT):
        if state is SupervisorState.READY:
            requests |= Fact.ARM
        elif state is SupervisorState.ARMED:
            requests |= Fact.START
    return requests


_REPORTS = (
    (Flag.SERIAL_FAULT, "W8", "a write failed"),
    (Flag.GUARDIAN_LOST, "W16", "its heartbeat stopped"),
    (Flag.GUARDIAN_TRIPPED, "W15", "the guardian braked the car: a tick was too late"),
    (Flag.RECORDER_LOST, "W26", "it is gone, hangs or is out of disk"),
    (Flag.GATEWAY_LOST, "W27", "it is gone or hangs, or no heartbeat comes back from the bus"),
    (Flag.EXCEPTION, "W29", "in the control core"),
    (Flag.SUSPENDED, "W28", "the machine slept"),
    (Flag.REBOOTED, "W12", "its uptime went back"),
)


def make_reported_findings(flags: int) -> Iterator[Finding]:
    """Findings of the watchdogs that the runner implements."""
    if flags != Flag.LINKED:
        for flag, name, text in _REPORTS:
            if flags & flag:
                yield make_finding(name, text)


WINDOW_NS = 1_000_000_000  # time over which missed ticks are counted


class LatenessRules(NamedTuple):
    """Limits beyond which the car is stopped."""

    late_ns: int  # lateness of one tick
    run: int  # number of missed ticks in a row
    share: float  # share of missed ticks in a second


def make_lateness_rules(thresholds: Thresholds) -> LatenessRules:
    """The limits of a car file, for hardware."""
    late_ns = round(thresholds.late * 1e9)
    return LatenessRules(late_ns, thresholds.late_run, thresholds.late_share)


ON_HARDWARE = make_lateness_rules(Thresholds())
IN_SIMULATION = LatenessRules(250_000_000, 25, 0.5)
"""For a simulated car: stalls of a laptop are only counted and reported as warnings."""


@quick_value
class Lateness:
    """Missed ticks (later than one period): in a row, in the current second."""

    run: int = 0
    missed: int = 0
    window_ns: int = 0


def step_lateness(
    state: Lateness, due_ns: int, woke_ns: int, period_ns: int, rules: LatenessRules = ON_HARDWARE
) -> tuple[Lateness, Finding | None]:
    """Count one tick; the finding says which of the three limits it exceeds."""
    late = woke_ns - due_ns
    missed = late > period_ns
    if due_ns - state.window_ns > WINDOW_NS:
        state = changed(state, missed=0, window_ns=due_ns)
    run = state.run + 1 if missed else 0
    state = changed(state, run=run, missed=state.missed + missed)
    if late > rules.late_ns:
        return state, make_finding("W15", f"a tick {late / 1e6:.0f} ms late")
    if state.run >= rules.run:
        return state, make_finding("W15", f"{state.run} ticks in a row missed")
    per_second = WINDOW_NS / period_ns
    if state.missed > max(1.0, rules.share * per_second):
        return state, make_finding("W15", f"{state.missed} of {per_second:.0f} ticks missed")
    return state, make_finding("W15", f"{late / 1e6:.1f} ms", Severity.WARN) if missed else None


_BLAMES = {
    Flag.STALLED: "the host of this virtual machine took the processor away: drive from a real one",
    Flag.ALL_LATE: "all processes stood still at once: this machine stalled; "
    "steerd rtcheck --under-load",
    Flag.ALONE_LATE: f"this program alone was late; {WATCHDOGS['W15'].advice}",
}
"""Who made this one tick late."""
CAUSES = sum(_BLAMES)


def blame_late(late: Finding, flags: int) -> Finding:
    """The finding of a late tick with who made it late, as far as the runner knows."""
    why = next((why for flag, why in _BLAMES.items() if flags & flag), None)
    return late if why is None else blame(late, why)
