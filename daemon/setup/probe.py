"""The findings of `steerd probe`: what is there, what is wrong, what to do. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees, inf

from steerd.daemon.loop.checks import check_vesc
from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.setup.mocap_check import REJECTED_MAX
from steerd.mocap_link.gates import REASONS
from steerd.steer_bus.messages import BODY, VescIdentity, make_header

VESC_USB = "0483:5740"
TOOL_SERVO = "VESC Tool: App Settings > General > Enable Servo Output"
SERVO_SINCE = (5, 3)  # first firmware whose ordinary build has a servo output
LOW_CELL = 3.3  # below this a lithium cell sags under load [V]
JITTER_MAX_MS = 5.0  # largest variation of the age of poses [ms]
ROUND_TRIP_MAX_MS = 10.0  # largest time from request to answer of a VESC: one tick of the loop [ms]
ANSWERED_MIN = 0.95  # smallest share of requests that a VESC answers [-]
RATE_MIN = 0.8  # smallest share of a server's frames that arrive [-]
TILT_MAX = 0.1  # largest tilt of the body of a standing car [rad]


@dataclass(frozen=True)
class Advice:
    """One finding: what was found and what to do; `fix` is empty where nothing is to do."""

    what: str
    fix: str = ""


@dataclass(frozen=True)
class VescFound:
    """A VESC that answered."""

    firmware: tuple[int, int]  # (major, minor)
    hardware: str  # its name for its board
    uuid: str  # 24 hex digits
    timeout_ms: int | None  # of its own watchdog; None where unknown, 0 for never
    timeout_brake_a: float | None  # brake current after the timeout [A]
    voltage: float | None  # of the battery [V]
    fault: str  # name of its fault; empty for none
    temp_fet_c: float | None  # of its power stage [°C]
    round_trip_ms: float | None  # median time from request to answer
    answered: float  # share of requests that were answered
    imu: bool  # whether it has an IMU that answers


@dataclass(frozen=True)
class SerialFound:
    """A serial port: a VESC, or why not."""

    port: str
    usb: str
    vesc: VescFound | None
    advice: tuple[Advice, ...]


@dataclass(frozen=True)
class MocapSeen:
    """What a mocap server sent while it was listened to."""

    address: str  # as `--mocap` takes it
    server: str = ""  # its name and version; empty when it did not answer
    bodies: tuple[str, ...] = ()  # that it offers
    detail: str = ""  # the source's latest status
    seconds: float = 0.0  # how long it was listened to
    samples: int = 0  # number of poses of the named body
    accepted: int = 0  # number of these that passed the pose checks
    rate_hz: float = 0.0  # of frames
    expected_rate_hz: float | None = None  # the server's own figure; None where unknown
    clock: str = ""  # how poses are timed; empty before the first
    clock_sigma_ms: float | None = None  # standard deviation of the server's clock offset
    latency_ms: float | None = None  # median age of a pose when it arrives
    jitter_ms: float | None = None  # 95th minus 5th percentile of that age
    height: float | None = None  # median [m]
    tilt: float | None = None  # median [rad]
    refused: tuple[tuple[str, int], ...] = ()  # pose checks that failed, and how often
    advice: tuple[Advice, ...] = ()  # what is wrong with it


@dataclass(frozen=True)
class SocketFound:
    """A port in use on this machine that zenoh, NatNet or VRPN use."""

    kind: str
    address: str
    port: int
    meaning: str


@dataclass(frozen=True)
class Found:
    """All that was found; `in_dialout` is whether this user may open serial ports by group."""

    serial: tuple[SerialFound, ...]
    mocap: tuple[MocapSeen, ...]
    sockets: tuple[SocketFound, ...]
    in_dialout: bool


def judge_vesc(vesc: VescFound, brakes: BrakeSettings) -> Iterator[Advice]:
    """Findings about a VESC."""
    timeout_ms, brake = vesc.timeout_ms, vesc.timeout_brake_a
    timeout_ms = -1 if timeout_ms is None or brake is None else timeout_ms
    header = make_header(0, BODY)
    info = VescIdentity(header, 0, timeout_ms, 1, *vesc.firmware, brake or 0.0, vesc.uuid)
    for text in check_vesc(info, brakes):
        what, _, fix = text.partition(": ")
        yield Advice(what, fix)
    if vesc.firmware < SERVO_SINCE:
        version = f"{vesc.firmware[0]}.{vesc.firmware[1]:02d}"
        what = f"firmware {version} has a servo output only in its 'servoout' build"
        yield Advice(what, "update to 5.03 or newer in VESC Tool, then enable the servo output")
    else:
        yield Advice(
            "the VESC does not report whether its servo output is on: it accepts servo commands "
            "either way",
            f"if the wheels do not move in `steerd calibrate servo`, set {TOOL_SERVO}, with an app "
            "that does not use the PPM pin",
        )
    if vesc.fault:
        yield Advice(f"the VESC reports {vesc.fault}", "VESC Tool: Terminal > `faults` shows more")
    if vesc.voltage is not None and vesc.voltage < LOW_CELL * brakes.cells:
        what = f"the battery is at {vesc.voltage:.1f} V, {brakes.cells} cells"
        yield Advice(what, "charge it (or set [vesc] cells in the car file)")
    slow = vesc.round_trip_ms is not None and vesc.round_trip_ms > ROUND_TRIP_MAX_MS
    if slow or vesc.answered < ANSWERED_MIN:
        took = f"answers take {vesc.round_trip_ms or inf:.1f} ms"
        what = f"{took}, {vesc.answered:.0%} of them arrive"
        yield Advice(what, "use a USB port of the computer itself, and a shorter cable")


def judge_mocap(seen: MocapSeen, named: bool) -> Iterator[Advice]:
    """Findings about a mocap source; `named`: whether a body was, or only a server was found."""
    if not seen.server:
        yield Advice(
            f"no answer: {seen.detail}",
            "is streaming on (Motive: Settings > Streaming > NatNet, or VRPN), is the address its "
            "'local interface', and does the firewall let UDP 1510 and 1511 (VRPN: TCP 3883) pass?",
        )
        return
    if not named:
        return
    if not seen.samples:
        fix = (
            "define a rigid body in the mocap software and stream it; with multicast, name this "
            "machine's address on the mocap network: ?interface=ADDRESS"
        )
        if seen.bodies:
            fix = f"the server offers {', '.join(seen.bodies)}: name one of them in --mocap"
        yield Advice(f"the server answers, but no pose came: {seen.detail}", fix)
        return
    yield from _judge_poses(seen)
    if seen.expected_rate_hz and seen.rate_hz < RATE_MIN * seen.expected_rate_hz:
        what = f"{seen.rate_hz:.0f} of {seen.expected_rate_hz:.0f} frames per second arrive"
        fix = "use a cable instead of Wi-Fi, or stream less (fewer bodies, no markers)"
        yield Advice(what, fix)
    if seen.jitter_ms is not None and seen.jitter_ms > JITTER_MAX_MS:
        what = f"the age of poses varies by {seen.jitter_ms:.0f} ms"
        yield Advice(what, "use a cable instead of Wi-Fi; close what loads this machine")


_FIXES = {
    "units": "set [mocap] units = \"mm\" in the car file",
    "tilt": "set [mocap] up to the server's up axis, or reset the body's orientation there",
    "height": "does another body have its markers? make the marker patterns differ",
    "invalid": "does the volume see the car's markers? add markers or cameras",
    "mean_error": "calibrate the cameras, or fix loose markers",
    "not_live": "the server plays a recording: switch it to live",
}  # fmt: skip


def _judge_poses(seen: MocapSeen) -> Iterator[Advice]:
    for check, count in seen.refused:
        if count > REJECTED_MAX * seen.samples:
            fix = _FIXES.get(check, REASONS.get(check, ""))
            yield Advice(f"{count} of {seen.samples} poses are rejected: {check}", fix)
    reported = any(check == "tilt" for check, _ in seen.refused)
    if seen.tilt is not None and seen.tilt > TILT_MAX and not reported:
        fix = "reset the body's orientation in the mocap software with the car on the floor"
        yield Advice(f"the body leans by {degrees(seen.tilt):.0f}° while the car stands", fix)
