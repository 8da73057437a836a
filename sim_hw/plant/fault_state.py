"""What can be wrong with the simulated hardware at one moment: plain values that devices look at.

`faults` sets them; at their defaults the hardware is healthy.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VescFaultState:
    """Fault state of the VESC and its link.

    Attributes:
        plugged: whether the cable is in.
        outage_ns: how long the cable is out before the condition begins.
        port_suffix: appended to the port's name while the device is there.
        uuid: identity instead of its own.
        mute: takes commands, answers nothing.
        deaf: answers, ignores commands, keeps the last one (bldc #926).
        stalled: reads nothing, so the host's transmit buffer fills.
        trickle_ns: time per reply byte; 0 is full speed.
        garbage: noise bytes before each reply.
        corrupt: probability that a reply frame has a flipped bit.
        drop: probability that a reply is lost.
        delay_ns, jitter_ns: added to each reply; the second times a number in [0, 1).
        truncate: the next reply is cut in half, then nothing more.
        false_header: sends a long frame's header (03 02 00) once: it belongs to no frame.
        wrong: replies are of another ``type``, ``length`` or ``firmware``; empty for right ones.
        unsolicited: an unknown frame before each reply.
        fault_code: condition held, hence its code; 0 for none.
        fault_once: fault that strikes once and clears itself; 0 for none.
        reboot: restarts once.
        sag: battery voltage missing [V].
        heat_c: temperature added.
        timeout_bit: the status says that the timeout struck.
        kill: the kill switch is on.
        erpm_stuck: ERPM stays at the value it has.
        erpm_sign: -1 flips the reported ERPM.
        servo_dead: no servo output.
        alive_ns: a second client sends ALIVE with this period; 0 for none.
        timeout_ms, timeout_brake_current: app settings instead of its own.
    """

    plugged: bool = True
    outage_ns: int = 0
    port_suffix: str = ""
    uuid: bytes | None = None
    mute: bool = False
    deaf: bool = False
    stalled: bool = False
    trickle_ns: int = 0
    garbage: int = 0
    corrupt: float = 0.0
    drop: float = 0.0
    delay_ns: int = 0
    jitter_ns: int = 0
    truncate: bool = False
    false_header: bool = False
    wrong: str = ""
    unsolicited: bool = False
    fault_code: int = 0
    fault_once: int = 0
    reboot: bool = False
    sag: float = 0.0
    heat_c: float = 0.0
    timeout_bit: bool = False
    kill: bool = False
    erpm_stuck: bool = False
    erpm_sign: int = 1
    servo_dead: bool = False
    alive_ns: int = 0
    timeout_ms: int | None = None
    timeout_brake_current: float | None = None


@dataclass(frozen=True, slots=True)
class MocapFaultState:
    """Fault state of the mocap system and its network.

    Attributes:
        since_ns: when the present condition began.
        silent: no frames.
        gap_ns, gap_every_ns: no frames for the first ``gap_ns`` of every ``gap_every_ns``.
        frozen: the pose stays, frames and stamps go on.
        resend: the last frame again and again.
        jump: displacement [m].
        drift: displacement per second [m/s].
        flip: "" no, "always" or "alternate" by half a turn.
        garble: "" no, "nan" or "zeros".
        scale: factor of all lengths.
        impostor: the car's name is on another, standing thing.
        swap: car and the other thing have changed names.
        absent: the body is not in the frames.
        invalid: frames say that the body is not tracked, with its last pose.
        negative: q and -q in turns (harmless).
        mean_error: added to the residual [m].
        latency_ns, jitter_ns: added to the latency; the second times a number in [0, 1).
        reorder: every second frame comes after its successor.
        duplicate: every frame twice.
        loss: probability that a frame is lost.
        noise: malformed datagrams between frames: "", "truncated", "oversized" or "garbage".
        foreign: frames from another sender [m] away; 0 for none.
        clock_step_ns: added to the server's clock.
        every: one of so many frames is sent.
        edit_mode: the server replays a recording.
        model_changed: the model list changes once.
        restart: the server restarts once: its clock and numbers begin again.
        half_open: the TCP peer is gone without a word.
    """

    since_ns: int = 0
    silent: bool = False
    gap_ns: int = 0
    gap_every_ns: int = 0
    frozen: bool = False
    resend: bool = False
    jump: float = 0.0
    drift: float = 0.0
    flip: str = ""
    garble: str = ""
    scale: float = 1.0
    impostor: bool = False
    swap: bool = False
    absent: bool = False
    invalid: bool = False
    negative: bool = False
    mean_error: float = 0.0
    latency_ns: int = 0
    jitter_ns: int = 0
    reorder: bool = False
    duplicate: bool = False
    loss: float = 0.0
    noise: str = ""
    foreign: float = 0.0
    clock_step_ns: int = 0
    every: int = 1
    edit_mode: bool = False
    model_changed: bool = False
    restart: bool = False
    half_open: bool = False


HEALTHY_VESC = VescFaultState()
HEALTHY_MOCAP = MocapFaultState()
