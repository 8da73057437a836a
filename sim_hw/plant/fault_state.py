"""What can be wrong with the simulated hardware at one moment: plain values that devices look at.

`faults` sets them; at their defaults the hardware is healthy.
"""

from dataclasses import dataclass


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
    delay_ns: int = 0  # added to each reply; the second times a number in [0, 1)
    jitter_ns: int = 0
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
