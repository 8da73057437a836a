"""What can go wrong with the simulated hardware: values that devices look at, and the catalogue.

A fault is a set of changes to the fault state, by name and within a time window; faults at the same
time add up, and where two change the same field, the later in the list wins. At its defaults the
fault state is healthy. Names M1-M22 and V1-V24 are those of
`docs/reference/safety-requirements.md#s6`; the names beside them work as well. Faults without a
number come from `docs/reference/mocap-protocols.md#m6.1` and `docs/reference/vesc-serial.md#v8`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple


@dataclass(frozen=True, slots=True)
class VescFaultState:
    """Fault state of the VESC and its link."""

    plugged: bool = True  # whether the cable is in
    outage_ns: int = 0  # how long the cable is out before the condition begins
    port_suffix: str = ""  # appended to the port's name while the device is there
    uuid: bytes | None = None  # identity instead of its own
    mute: bool = False  # takes commands, answers nothing
    deaf: bool = False  # answers, ignores commands, keeps the last one (bldc #926)
    stalled: bool = False  # reads nothing, so the host's transmit buffer fills
    trickle_ns: int = 0  # time per reply byte; 0 is full speed
    garbage: int = 0  # noise bytes before each reply
    corrupt: float = 0.0  # probability that a reply frame has a flipped bit
    drop: float = 0.0  # probability that a reply is lost
    jitter_ns: int = 0  # added to each reply, times a number in [0, 1)
    truncate: bool = False  # the next reply is cut in half, then nothing more
    # Sends a long frame's header (03 02 00) once: it belongs to no frame
    false_header: bool = False
    # Replies are of another ``type``, ``length`` or ``firmware``; empty for right ones
    wrong: str = ""
    unsolicited: bool = False  # an unknown frame before each reply
    fault_code: int = 0  # condition held, hence its code; 0 for none
    fault_once: int = 0  # fault that strikes once and clears itself; 0 for none
    reboot: bool = False  # restarts once
    sag: float = 0.0  # battery voltage missing [V]
    heat_c: float = 0.0  # temperature added
    timeout_bit: bool = False  # the status says that the timeout struck
    kill: bool = False  # the kill switch is on
    erpm_stuck: bool = False  # ERPM stays at the value it has
    erpm_sign: int = 1  # -1 flips the reported ERPM
    servo_dead: bool = False  # no servo output
    alive_ns: int = 0  # a second client sends ALIVE with this period; 0 for none
    timeout_ms: int | None = None  # app settings instead of its own
    timeout_brake_current: float | None = None


@dataclass(frozen=True, slots=True)
class MocapFaultState:
    """Fault state of the mocap system and its network."""

    since_ns: int = 0  # when the present condition began
    silent: bool = False  # no frames
    gap_ns: int = 0  # no frames for the first ``gap_ns`` of every ``gap_every_ns``
    gap_every_ns: int = 0
    frozen: bool = False  # the pose stays, frames and stamps go on
    resend: bool = False  # the last frame again and again
    jump: float = 0.0  # displacement [m]
    drift: float = 0.0  # displacement per second [m/s]
    flip: str = ""  # "" no, "always" or "alternate" by half a turn
    garble: str = ""  # "" no, "nan" or "zeros"
    scale: float = 1.0  # factor of all lengths
    impostor: bool = False  # the car's name is on another, standing thing
    swap: bool = False  # car and the other thing have changed names
    absent: bool = False  # the body is not in the frames
    invalid: bool = False  # frames say that the body is not tracked, with its last pose
    negative: bool = False  # q and -q in turns (harmless)
    mean_error: float = 0.0  # added to the residual [m]
    latency_ns: int = 0  # added to the latency; the second times a number in [0, 1)
    jitter_ns: int = 0
    reorder: bool = False  # every second frame comes after its successor
    duplicate: bool = False  # every frame twice
    loss: float = 0.0  # probability that a frame is lost
    noise: str = ""  # malformed datagrams between frames: "", "truncated", "oversized" or "garbage"
    foreign: float = 0.0  # frames from another sender [m] away; 0 for none
    clock_step_ns: int = 0  # added to the server's clock
    every: int = 1  # one of so many frames is sent
    edit_mode: bool = False  # the server replays a recording
    model_changed: bool = False  # the model list changes once
    restart: bool = False  # the server restarts once: its clock and numbers begin again
    half_open: bool = False  # the TCP peer is gone without a word


HEALTHY_VESC = VescFaultState()
HEALTHY_MOCAP = MocapFaultState()


FOREVER = 1 << 62
_MS = 1_000_000
Param = bool | int | float | str | bytes | None


class FaultKind(NamedTuple):
    """One entry of the catalogue."""

    code: str
    name: str
    target: str  # ``mocap`` or ``vesc``: whose fault state it changes
    summary: str
    settings: Mapping[str, Param]
    """Fields of the fault state and their values by default; each can be given as a parameter."""


def _kind(target: str, code: str, name: str, summary: str, **settings: Param) -> FaultKind:
    return FaultKind(code, name, target, summary, settings)


_mocap, _vesc = partial(_kind, "mocap"), partial(_kind, "vesc")
_OTHER_UUID = bytes.fromhex("0badc0de0badc0de0badc0de")

FAULTS: tuple[FaultKind, ...] = (
    _mocap("M1", "silence", "no frames, no answers", silent=True),
    _mocap("M2", "freeze", "the same pose with new stamps", frozen=True),
    _mocap("M3", "resend", "the same frame again and again", resend=True),
    _mocap("M4", "jump", "the pose jumps", jump=0.5),
    _mocap("M5", "drift", "the pose drifts away", drift=0.1),
    _mocap("M6", "yaw_flip", "the heading turns by 180 degrees", flip="always"),
    _mocap("M7", "yaw_alternating", "the heading flips every frame", flip="alternate"),
    _mocap("M8", "nan", "NaN in the pose", garble="nan"),
    _mocap("M9", "zeros", "position and quaternion all zero", garble="zeros"),
    _mocap("M10", "millimetres", "lengths in millimetres", scale=1000.0),
    _mocap("M11", "wrong_body", "the car's name is on a thing that stands", impostor=True),
    _mocap("M12", "body_swap", "car and another thing change names", swap=True),
    _mocap("M13", "latency_step", "80 ms more latency", latency_ns=80 * _MS),
    _mocap("M14", "jitter_burst", "up to 40 ms random latency", jitter_ns=40 * _MS),
    _mocap("M15", "out_of_order", "each second frame after its successor", reorder=True),
    _mocap("M16", "duplicated", "every frame twice", duplicate=True),
    _mocap("M17", "loss", "5 % of the frames are lost", loss=0.05),
    _mocap("M18", "gap", "no frames for 50 ms of every second",
           gap_ns=50 * _MS, gap_every_ns=1000 * _MS),
    _mocap("M19", "garbage", "malformed datagrams between", noise="truncated"),
    _mocap("M20", "foreign_sender", "someone else sends frames", foreign=1.0),
    _mocap("M21", "clock_step", "the server's clock steps", clock_step_ns=1000 * _MS),
    _mocap("M22", "rate_halves", "every second frame only", every=2),
    _mocap("", "invalid", "the body is not tracked, its last pose goes on", invalid=True),
    _mocap("", "body_removed", "the body is not in the frames", absent=True),
    _mocap("", "edit_mode", "the server replays a recording", edit_mode=True),
    _mocap("", "model_change", "the model list changes", model_changed=True),
    _mocap("", "server_restart", "clock and frame numbers begin again", restart=True),
    _mocap("", "quaternion_sign", "q and -q in turns", negative=True),
    _mocap("", "mean_error_ramp", "a large marker residual", mean_error=0.02),
    _mocap("", "half_open", "the TCP peer is gone without a word", half_open=True),
    _vesc("V1", "unplug", "the USB cable is out", plugged=False),
    _vesc("V2", "replug_other_name", "unplugged, back under another name",
          port_suffix="-1", outage_ns=300 * _MS),
    _vesc("V3", "replug_other_uuid", "unplugged, then another VESC is there",
          uuid=_OTHER_UUID, outage_ns=300 * _MS),
    _vesc("V4", "no_replies", "takes commands, answers nothing", mute=True),
    _vesc("V5", "ignores_commands", "answers, keeps the last motor command", deaf=True),
    _vesc("V6", "reader_stalled", "reads nothing: the transmit buffer fills", stalled=True),
    _vesc("V7", "slow_trickle", "replies come one byte per 5 ms", trickle_ns=5 * _MS),
    _vesc("V8", "garbage_burst", "noise before each reply", garbage=64),
    _vesc("V9", "crc_errors", "flipped bits in 10 % of the replies", corrupt=0.1),
    _vesc("V10", "partial_then_silence", "half a reply, then nothing", truncate=True),
    _vesc("V11", "false_long_header", "the head of a 512-byte frame", false_header=True),
    _vesc("V12", "wrong_replies", "replies of another type", wrong="type"),
    _vesc("V13", "fault_code", "a fault condition that stays", fault_code=3),
    _vesc("V14", "fault_self_clearing", "a fault that clears itself", fault_once=4),
    _vesc("V15", "reboot", "the VESC restarts", reboot=True),
    _vesc("V16", "under_voltage", "the battery sags below the limit", sag=5.0),
    _vesc("V17", "over_temperature", "the switches are too hot", heat_c=90.0),
    _vesc("V18", "timeout_bit", "the status says timeout", timeout_bit=True),
    _vesc("V19", "kill_switch", "the kill switch is on", kill=True),
    _vesc("V20", "erpm_stuck", "ERPM stays what it was", erpm_stuck=True),
    _vesc("V21", "erpm_flipped", "ERPM has the wrong sign", erpm_sign=-1),
    _vesc("V22", "servo_disabled", "no servo output", servo_dead=True),
    _vesc("V23", "second_client_alive", "a phone app feeds the timeout", alive_ns=200 * _MS),
    _vesc("V24", "no_timeout", "timeout and brake current 0", timeout_ms=0,
          timeout_brake_current=0.0),
    _vesc("", "reply_loss", "5 % of the replies are lost", drop=0.05),
    _vesc("", "reply_jitter", "up to 8 ms late", jitter_ns=8 * _MS),
    _vesc("", "unsolicited", "unknown frames between", unsolicited=True),
)  # fmt: skip
_BY_NAME = {key: kind for kind in FAULTS for key in (kind.code, kind.name) if key}


def find_fault(name: str) -> FaultKind:
    """The catalogue's entry for a code (``M4``) or a name (``jump``).

    Raises:
        ValueError: there is none.
    """
    kind = _BY_NAME.get(name)
    if kind is None:
        names = ", ".join(k.name for k in FAULTS)
        raise ValueError(f"no fault {name!r}; known: M1 to M22, V1 to V24, {names}")
    return kind


class Fault:
    """A fault by code or name from ``t_from_ns`` to just before ``t_to_ns`` of the world's time.

    ``params`` are settings that differ from the catalogue's (``Fault("M4", 0, jump=1.0)``).

    Raises:
        ValueError: no such fault or setting, or an empty window.
    """

    def __init__(
        self, name: str, t_from_ns: int = 0, t_to_ns: int = FOREVER, **params: Param
    ) -> None:
        self.kind, self.t_from_ns, self.t_to_ns = find_fault(name), t_from_ns, t_to_ns
        target = HEALTHY_MOCAP if self.kind.target == "mocap" else HEALTHY_VESC
        for setting in params:
            if not hasattr(target, setting):
                raise ValueError(f"fault {name}: no setting {setting!r}")
        if t_from_ns >= t_to_ns:
            raise ValueError(f"fault {name}: it ends before it begins")
        self.settings: dict[str, Any] = {**self.kind.settings, **params}  # what it changes


class Condition(NamedTuple):
    """The fault state at one moment and when they next change."""

    vesc: VescFaultState
    mocap: MocapFaultState
    until_ns: int


def make_condition(faults: Sequence[Fault], t_ns: int, t_start_ns: int = 0) -> Condition:
    """The fault state at ``t_ns`` with these faults, in a world that began at ``t_start_ns``."""
    vesc, mocap, edges = HEALTHY_VESC, HEALTHY_MOCAP, [FOREVER]
    for fault in faults:
        begin, end = fault.t_from_ns + t_start_ns, fault.t_to_ns + t_start_ns
        plugged_ns = begin + fault.settings.get("outage_ns", 0)
        edges += [edge for edge in (begin, plugged_ns, end) if edge > t_ns]
        if not begin <= t_ns < end:
            continue
        if fault.kind.target == "vesc":
            vesc = replace(vesc, **fault.settings)
            if t_ns < plugged_ns:
                vesc = replace(vesc, plugged=False)
        else:
            since = min(begin, mocap.since_ns or begin)
            mocap = replace(mocap, since_ns=since, **fault.settings)
    return Condition(vesc, mocap, min(edges))
