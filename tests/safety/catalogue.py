"""Every fault of the matrix: how it is brought about, and what the car must do about it.

Bounds are detection bounds derived from the watchdogs' thresholds, not from what was measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from math import inf, nan
from operator import attrgetter, methodcaller
from typing import Any

from steerd.car_model.state import Command
from steerd.daemon.loop.findings import Flag
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, DriveCommand, OperatorRequest, RequestKind, make_header
from tests.safety import catalogue_car as car
from tests.safety.rig import BOOT_ID, LEASE_ID, MS, Rig

FRAME, TRANSIT = 0.010, 0.006
"""Seconds from one mocap frame to the next, and from exposure to arrival."""
STALE = 0.150  # W1 below 2 m/s: as long as 0.30 m allow
MUTE = 0.100 + 0.020  # W7, counted from the last poll's answer
COAST = 0.6
"""Slowing of a car whose motor is let go [m/s^2]; nothing on the wire can do better then."""


class Must(Enum):
    """What a fault asks for while the car moves."""

    STOP_HARD = "FAULT_STOP"
    STOP_SOFT = "STOPPING"
    ESTOP = "ESTOP"
    LIVE_ON = "no stop"
    STAY_SAFE = "stop, or stay in the lane"
    """Not distinguishable from healthy hardware: stay in the lane, stop on request."""


Act = Callable[[Rig], None]


def nothing(_rig: Rig) -> None: ...


@dataclass(frozen=True)
class FaultCase:
    code: str  # of `docs/reference/safety-requirements.md#s6`; variants carry a letter
    name: str
    begin: Act  # brings it about, once
    must: Must  # what the car must do while it moves
    bound_s: float = 0.0  # from the fault to the first stop byte, without the tick that follows
    at: Mapping[str, Must] = field(default_factory=dict)  # what differs in a phase
    each: Act = nothing  # brings it about again before every tick
    asks_stop: bool = False  # the operator asks for a stop 0.5 s later, since nothing else may
    wire: bool = True  # bytes still reach the VESC; if not, its own timeout stops the car
    obeys: bool = True  # the VESC still does what it is commanded
    blind_s: float = 0.0  # how long nothing slows the car, beyond the bound
    decel: float = inf  # how hard the car can slow down at all [m/s^2]
    # What happens to an operator who arms and drives with this fault there from the start: `red` is
    # never armed, `launch` is stopped in the launch window
    cold: str = ""
    unseen: str = ""  # phases in which a standing car cannot see what would otherwise be `red`
    inside: bool = False  # brought about within the program, as virtual time has no processes
    rearms: bool = False  # a person asked for the stop, after which the car stays armed
    lane_m: float = 0.40  # how far it may get beside its path; more where nothing can steer it
    within_m: float = inf  # how far it may get from where it was


def raise_flag(flag: Flag) -> Act:
    def act(rig: Rig) -> None:
        rig.run.core.flags |= flag

    return act


HARD, SOFT, LIVE, SAFE = Must.STOP_HARD, Must.STOP_SOFT, Must.LIVE_ON, Must.STAY_SAFE


def _of_hardware(
    code: str, name: str, must: Must, bound_s: float = 0.0, *, fault: str = "", **more: Any
) -> FaultCase:
    """A case of the simulated hardware; what is no field of a case is a parameter of its fault."""
    of_case = {each.name for each in fields(FaultCase)}
    params = {key: value for key, value in more.items() if key not in of_case}
    rest = {key: value for key, value in more.items() if key in of_case}
    act = methodcaller("break_it", fault or code, **params)
    return FaultCase(code, name, act, must, bound_s, **rest)


def _mocap() -> tuple[FaultCase, ...]:
    def row(code: str, name: str, must: Must, frames: float = 0.0, **more: Any) -> FaultCase:
        bound = more.pop("bound_s", (frames + 1) * FRAME + TRANSIT if frames else 0.0)
        return _of_hardware(code, name, must, bound, **more)

    stale = {"bound_s": STALE}
    return (
        row("M1", "silence", HARD, **stale, cold="red"),
        row("M2", "freeze: same pose, new stamps", HARD, 5, cold="launch"),
        row("M3", "same frame resent", HARD, **stale, cold="red"),
        row("M4", "jump of 0.5 m", HARD, 3),
        row("M5", "drift of 0.1 m/s", SAFE, asks_stop=True),
        row("M6", "yaw flipped by 180 deg", HARD, 3, cold="red"),
        row("M7", "yaw alternating", HARD, 10, cold="red"),
        row("M8", "NaN", HARD, **stale, cold="red"),
        row("M9", "zeros, zero quaternion", HARD, **stale, cold="red"),
        row("M10", "millimetres", HARD, 3, cold="launch"),
        row("M11", "name on another body", HARD, **stale, cold="red"),
        row("M12", "two bodies swapped", HARD, **stale, cold="red"),
        row("M13", "80 ms more latency", SAFE, asks_stop=True),
        row("M14", "40 ms jitter", SAFE, asks_stop=True),
        row("M15", "out of order", SAFE, asks_stop=True),
        row("M16", "every frame twice", LIVE),
        row("M17", "5 % random loss", LIVE),
        row("M18", "50 ms gaps", LIVE),
        row("M19", "truncated datagrams between", LIVE),
        row("M19b", "oversized datagrams between", LIVE, fault="M19", noise="oversized"),
        row("M19c", "random datagrams between", LIVE, fault="M19", noise="garbage"),
        row("M20", "foreign sender", LIVE),
        row("M21", "server clock steps by +1 s", SAFE, asks_stop=True),
        row("M21b", "server clock steps by -1 s", SAFE, asks_stop=True, fault="M21",
            clock_step_ns=-1000 * MS),
        row("M22", "rate halves", LIVE),
        row("M23", "body not tracked, old pose", HARD, **stale, fault="invalid", cold="red"),
        row("M24", "body missing in frames", HARD, **stale, fault="body_removed", cold="red"),
        row("M25", "server replays a recording", HARD, **stale, fault="edit_mode", cold="red"),
        row("M26", "model list changes", LIVE, fault="model_change"),
        row("M27", "server restarts", SAFE, asks_stop=True, fault="server_restart"),
        row("M28", "q and -q in turns", LIVE, fault="quaternion_sign"),
    )  # fmt: skip


def _vesc() -> tuple[FaultCase, ...]:
    row = _of_hardware
    poll = 0.030
    gone = {"wire": False, "blind_s": 0.160}
    return (
        row("V1", "unplugged", HARD, **gone, cold="red"),
        row("V2", "unplugged, back under another name", HARD, **gone),
        row("V3", "unplugged, another VESC comes back", HARD, **gone),
        row("V4", "takes bytes, answers nothing", HARD, MUTE, cold="red"),
        row("V5", "answers, ignores commands", SAFE, asks_stop=True, obeys=False),
        row("V6", "reads nothing, buffer fills", HARD, MUTE, **gone, cold="red"),
        row("V7", "one byte per 5 ms", HARD, MUTE, cold="red"),
        row("V8", "noise before each reply", LIVE),
        row("V9", "CRC errors in 10 %", LIVE),
        row("V9b", "CRC errors in 100 %", HARD, MUTE, fault="V9", corrupt=1.0, cold="red"),
        row("V10", "half a reply, then silence", HARD, MUTE, cold="red"),
        row("V11", "head of a long frame", LIVE),
        row("V12", "replies of another type", HARD, MUTE, cold="red"),
        row("V12b", "replies of another length", HARD, MUTE, fault="V12", wrong="length"),
        row("V12c", "replies of another firmware", SAFE, fault="V12", wrong="firmware",
            asks_stop=True),
        row("V13", "fault code that stays", HARD, poll, decel=COAST, cold="red"),
        row("V14", "fault that clears itself", HARD, poll, decel=COAST),
        row("V15", "reboot", HARD, wire=False, blind_s=1.66, decel=3.5),
        row("V16", "under-voltage cut-off", HARD, poll + 0.010, decel=COAST, cold="red"),
        row("V16b", "battery low", SOFT, 0.5 + poll, fault="V16", sag=2.4, cold="red"),
        row("V17", "over-temperature cut-off", SOFT, poll, decel=COAST, cold="red"),
        row("V17b", "transistors hot", SOFT, poll, fault="V17", heat_c=62.0, cold="red"),
        row("V18", "status says timeout", HARD, poll, at={"P7": SAFE}),
        row("V19", "kill switch", Must.ESTOP, poll, decel=COAST, cold="red"),
        row("V20", "erpm stuck", SAFE, asks_stop=True, cold="launch"),
        row("V21", "erpm with the wrong sign", HARD, 0.2 + poll, cold="launch"),
        row("V22", "servo dead", SAFE, asks_stop=True),
        row("V23", "a phone app feeds the timeout", SAFE, asks_stop=True, cold="red",
            unseen="P1 P3"),
        row("V24", "timeout and brake current 0", SAFE, asks_stop=True, cold="red",
            unseen="P1 P2 P3"),
        row("V25", "5 % of replies lost", LIVE, fault="reply_loss"),
        row("V26", "replies up to 8 ms late", LIVE, fault="reply_jitter"),
        row("V27", "unknown frames between", LIVE, fault="unsolicited"),
    )  # fmt: skip


def _raise(*_: object) -> Any:
    raise RuntimeError("injected")


def _strand(rig: Rig) -> None:
    rig.run.core.latch_exception(RuntimeError("injected"))


def _break(part: str, method: str) -> Act:
    """A method of a part of the core raises from now on."""
    return lambda rig: setattr(attrgetter(part)(rig.run.core), method, _raise)


def _late(ms: float) -> Act:
    return lambda rig: setattr(rig, "late_ns", round(ms * MS))


def _inside(*args: Any, **more: Any) -> FaultCase:
    return FaultCase(*args, **more, inside=True)


def _host() -> tuple[FaultCase, ...]:
    return (
        _inside("H1", "SIGINT, SIGTERM or SIGHUP", raise_flag(Flag.QUIT), SOFT, cold="red",
            unseen="P1"),
        _inside("H2", "second signal", raise_flag(Flag.QUIT | Flag.ABORT), HARD, cold="red",
            unseen="P1"),
        _inside("H6", "guardian killed", raise_flag(Flag.GUARDIAN_LOST), SOFT, cold="red"),
        _inside("H6b", "guardian has tripped", raise_flag(Flag.GUARDIAN_TRIPPED), HARD, cold="red"),
        _inside("H7", "recorder killed or disk full", raise_flag(Flag.RECORDER_LOST), SOFT,
            cold="red"),
        _inside("H8", "gateway killed", raise_flag(Flag.GATEWAY_LOST), SOFT, cold="red"),
        FaultCase("H11", "every tick 12 ms late", nothing, HARD, 0.060, each=_late(12.0),
            cold="red"),
        FaultCase("H12", "200 ms asleep", _late(200.0), HARD, 0.200),
        FaultCase("H12b", "30 ms asleep", _late(30.0), HARD, 0.030),
        FaultCase("H12c", "one tick 20 ms late", _late(20.0), LIVE),
        _inside("H13", "exception in the controller", _break("loop", "_make_wish"), HARD,
            cold="red"),
        _inside("H13b", "exception in the filter", _break("loop.perception", "estimate"), HARD,
            cold="red"),
        _inside("H13c", "exception in a thread", _strand, HARD, cold="red"),
        _inside("H13d", "exception at a reply", _break("link", "on_bytes"), HARD, FRAME,
            cold="red"),
        _inside("H13e", "exception at a pose", _break("loop.perception", "on_pose"), HARD,
            2 * FRAME, cold="red"),
        _inside("H14", "NaN from the controller",
            lambda rig: car.wish_for(rig, lambda _: Command(nan, nan)), HARD, cold="launch"),
        _inside("H17", "suspended", raise_flag(Flag.SUSPENDED), HARD),
    )  # fmt: skip


def _foreign_drive(rig: Rig) -> None:
    header = make_header(0, BODY)
    for boot in (0, BOOT_ID, BOOT_ID + 1):
        command = DriveCommand(header, boot, 99, 0, rig.seq & 0xFFFF, 300, 0.3, 3.0)
        rig.deliver(encode(command), topics.DRIVE.name)


def _malformed(rig: Rig) -> None:
    header, kind = make_header(0, BODY), RequestKind.START
    asked = encode(OperatorRequest(header, BOOT_ID, LEASE_ID, 1 << 30, kind, "x"))
    for data in (b"", b"\0" * 7, b"\xff" * 300, asked[:-1], asked + b"xxxx"):
        rig.deliver(data)
        rig.deliver(data, topics.DRIVE.name)
        rig.deliver(data, "no/such/topic")


def _flood(rig: Rig) -> None:
    for _ in range(50):
        rig.ask(RequestKind.ARM, lease_id=99)
        rig.ask(RequestKind.START, boot_id=1)


def _replay(rig: Rig) -> None:
    for data in (*rig.said[-40:], *rig.said[:40]):
        rig.deliver(data)


def _second_operator(rig: Rig) -> None:
    for kind in (RequestKind.KEEPALIVE, RequestKind.ARM, RequestKind.START, RequestKind.CLEAR):
        rig.ask(kind, lease_id=LEASE_ID + 1)


def _ask(kind: int, lease_id: int = LEASE_ID) -> Act:
    return methodcaller("ask", kind, lease_id=lease_id)


def _network() -> tuple[FaultCase, ...]:
    return (
        FaultCase("Z1", "stranger's drive commands", nothing, LIVE, each=_foreign_drive),
        FaultCase("Z2", "malformed requests", nothing, LIVE, each=_malformed),
        FaultCase("Z3", "64 MiB payload", lambda rig: rig.deliver(bytes(64 << 20)), LIVE),
        FaultCase("Z4", "flood of 10k requests/s", nothing, LIVE, each=_flood),
        FaultCase("Z5", "old requests replayed", nothing, LIVE, each=_replay),
        FaultCase("Z6", "second operator", nothing, LIVE, each=_second_operator),
        FaultCase("Z6b", "second operator's stop", _ask(RequestKind.STOP, 99), SOFT, rearms=True),
        FaultCase("Z6c", "second operator's e-stop", _ask(RequestKind.ESTOP, 99), Must.ESTOP),
        FaultCase("Z7", "unknown request", _ask(200), SOFT),
        FaultCase("Z8", "operator gone", lambda rig: setattr(rig, "alive", False), SOFT, 0.3),
    )  # fmt: skip


def _car() -> tuple[FaultCase, ...]:
    """Car, lane and filter. What cannot be seen at rest begins to matter when the car moves."""
    lost = {"P4": SAFE, "P7": SAFE}
    return (
        FaultCase("C1", "steering jams at full lock", car.jam(-0.31), HARD, 0.2, lane_m=0.6),
        FaultCase("C2", "steering jams, a little off", car.jam(0.06), HARD, 1.0, at={"P4": SAFE}),
        FaultCase("C3", "motor runs at twice the order", car.surge, HARD, 0.2),
        FaultCase("C4", "wheels blocked", car.hit_a_wall, HARD, 0.12),
        _inside("C5", "fence ahead", car.fence_off, HARD, 1.5, within_m=car.FENCE_M),
        _inside("C6", "filter diverges", car.diverge, HARD, cold="red"),
        FaultCase("C7", "VESC restarts behind its port", car.restart_quietly, HARD, 1.0 + 0.02),
        _inside("C8", "controller at full lock", car.stuck(-0.31), HARD, 0.7, at=lost, lane_m=1.2),
        _inside("C9", "controller steers a little", car.stuck(0.06), HARD, 1.3, at=lost,
            lane_m=0.8),
        FaultCase("C10", "wheels accelerate by 2 m/s2", car.run_away, HARD, 0.3, cold="launch"),
        FaultCase("C11", "motor dead", car.die, HARD, 0.45, decel=COAST, cold="launch"),
        # What a servo does wrong does not show before it is told to turn: on the straight and in
        # the steady bend of these phases perhaps never. `python -m benchmarks.shown` turns.
        FaultCase("C12", "steering stays where it is", car.stick, SAFE, asks_stop=True),
        FaultCase("C13", "servo turns the other way", car.reverse, HARD, 1.5, at=lost, lane_m=0.6),
        FaultCase("C14", "servo ten times slower", car.slow_down, SAFE, asks_stop=True),
    )  # fmt: skip


FAULT_CASES = (*_mocap(), *_vesc(), *_host(), *_network(), *_car())
BY_CODE = {fault_case.code: fault_case for fault_case in FAULT_CASES}
