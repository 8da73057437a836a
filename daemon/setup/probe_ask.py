"""Queries: which serial ports are VESCs, which mocap servers are on the network. Nothing moves."""

import contextlib
import grp
import os
import select
import socket
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.setup import probe
from steerd.daemon.setup.mocap_check import Movement
from steerd.daemon.setup.probe import Advice, MocapSeen, SerialFound, SocketFound, VescFound
from steerd.mocap_link import natnet
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.natnet_wire import NatNetError
from steerd.mocap_link.sockets import MocapReceiver, make_receiver
from steerd.mocap_link.source import Pose
from steerd.steer_bus.clock import Clock, MonotonicClock
from steerd.vesc_link.ids import fault_name
from steerd.vesc_link.scaling import F1TENTH
from steerd.vesc_link.telemetry import Imu, Values
from steerd.vesc_link.transport import Port, PortError, open_port
from steerd.vesc_link.vesc import Answer, Drive, VescLink

CONNECT_NS = 1_500_000_000  # a VESC that has not identified itself after this is none [ns]
POLLS = 50  # requests for telemetry whose answers are counted
POLL_NS = 10_000_000  # time between two of them [ns]
DISCOVERY_NS = 1_000_000_000  # NatNet servers answer a discovery within this time [ns]
BROADCAST = ("255.255.255.255", "127.0.0.1")
ANSWER_S = 4.0  # a source without a pose after this has none: a client says so after 3 s [s]
PORTS = {
    ("tcp", 7447): "zenoh: a running steerd, or a zenoh router",
    ("udp", 1510): "NatNet commands: Motive or another server on this machine",
    ("udp", 1511): "NatNet data: another client of the mocap server",
    ("tcp", 3883): "VRPN: a mocap server on this machine",
}
_SILENT = Advice(
    "opened, but no VESC answered",
    "is it a VESC? is it powered by its battery? USB power alone starts some boards only",
)


# -- serial --------------------------------------------------------------------------------------


def find_ports(dev: Path = Path("/dev"), sysfs: Path = Path("/sys/class/tty")) -> dict[str, str]:
    """USB serial ports and their USB ids (`0483:5740`; empty where unknown)."""
    found = {}
    for path in sorted([*dev.glob("ttyACM*"), *dev.glob("ttyUSB*")]):
        found[str(path)] = ""
        for folder in (sysfs / path.name / "device").resolve().parents:
            with contextlib.suppress(OSError):
                ids = [(folder / name).read_text().strip() for name in ("idVendor", "idProduct")]
                found[str(path)] = ":".join(ids)
                break
    return found


def ask_ports(named: str | None, clock: Clock, brakes: BrakeSettings) -> Iterator[SerialFound]:
    """Identify the device on a port, or on all that may be VESCs; nothing moves the car."""
    ports = find_ports()
    for url in ports if named is None else [named]:
        usb, vesc, why = ports.get(url, ""), None, _SILENT
        if named is None and usb not in (probe.VESC_USB, ""):  # a lidar's, for instance
            what = f"left alone: USB id {usb}, a VESC has {probe.VESC_USB}"
            why = Advice(what, f"steerd probe --port {url}")
        else:
            try:
                with contextlib.closing(open_port(url)) as port:
                    vesc = _ask_vesc(port, clock)
            except PortError as error:
                why = Advice(str(error), error.hint)
        advice = probe.judge_vesc(vesc, brakes) if vesc else [why]
        yield SerialFound(url, usb, vesc, tuple(advice))


def _exchange(port: Port, link: VescLink, clock: Clock, wire: bytes) -> list[Answer]:
    """Write, and collect answers for `POLL_NS`."""
    if wire:
        port.write(wire)
    end, events = clock.now_ns() + POLL_NS, []
    while (left := end - clock.now_ns()) > 0:
        if select.select([port.fd], [], [], left * 1e-9)[0]:
            events += link.on_bytes(clock.now_ns(), port.read())
    events += link.on_bytes(clock.now_ns(), b"")
    return [event for event in events if isinstance(event, Answer)]


def _ask_vesc(port: Port, clock: Clock) -> VescFound | None:
    link = VescLink(F1TENTH)
    end = clock.now_ns() + CONNECT_NS
    while not link.ready and clock.now_ns() < end:
        _exchange(port, link, clock, link.make_connect(clock.now_ns()))
    version = link.version
    if version is None:
        return None
    answers: list[Answer] = []
    for _ in range(POLLS):
        answers += _exchange(port, link, clock, link.make_tick(Drive(), clock.now_ns()))
    polled = [(a, a.reply) for a in answers if isinstance(a.reply, Values)]
    last = polled[-1][1] if polled else None
    trips = [(a.t_received_ns - a.t_sent_ns) * 1e-6 for a, _ in polled]
    return VescFound(
        firmware=(version.major, version.minor),
        hardware=version.hw_name or "",
        uuid=version.uuid.hex() if version.uuid else "",
        timeout_ms=link.appconf.timeout_ms if link.appconf else None,
        timeout_brake_a=link.appconf.timeout_brake_current if link.appconf else None,
        voltage=last.input_voltage if last else None,
        fault=fault_name(last.fault) if last and last.fault else "",
        temp_fet_c=last.temp_fet_c if last else None,
        round_trip_ms=float(np.median(trips)) if trips else None,
        answered=min(1.0, len(polled) / POLLS),
        imu=any(isinstance(answer.reply, Imu) for answer in answers),
    )


# -- mocap ---------------------------------------------------------------------------------------


def discover(
    clock: Clock, addresses: Sequence[str] = BROADCAST, port: int = natnet.COMMAND_PORT
) -> dict[str, natnet.ServerInfo]:
    """NatNet servers that answer a discovery within a second, by address."""
    found: dict[str, natnet.ServerInfo] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sock.setblocking(False)
        for address in addresses:
            with contextlib.suppress(OSError):  # no network: no server
                sock.sendto(natnet.encode(natnet.Bare.DISCOVERY), (address, port))
        end = clock.now_ns() + DISCOVERY_NS
        while (left := end - clock.now_ns()) > 0:
            if not select.select([sock], [], [], left * 1e-9)[0]:
                break
            with contextlib.suppress(OSError, NatNetError):
                data, sender = sock.recvfrom(65536)
                info = natnet.decode(data, natnet.NEWEST_VERSION)
                if isinstance(info, natnet.ServerInfo):
                    found[sender[0]] = info
    return found


def ask_mocap(
    named: str | None, config: IngestConfig, clock: Clock, seconds: float
) -> Iterator[MocapSeen]:
    """Listen to a source for a while, or to each NatNet server that answers a discovery.

    Raises:
        ValueError: the address is none.
    """
    for address in [named] if named else [f"natnet://{host}/-" for host in discover(clock)]:
        url = parse_mocap_url(address)
        try:
            with contextlib.closing(make_receiver(url, config)) as receiver:
                receiver.ingest.stationary = True
                samples = list(listen(receiver, clock, seconds))
                seen = _seen(receiver, address, samples, seconds)
        except OSError as error:
            seen = MocapSeen(address, detail=str(error))
        yield replace(seen, advice=tuple(probe.judge_mocap(seen, named=named is not None)))


def listen(receiver: MocapReceiver, clock: Clock, seconds: float) -> Iterator[Pose]:
    """The samples of so many seconds, as they come."""
    end = clock.now_ns() + round(seconds * 1e9)
    while clock.now_ns() < end:
        receiver.on_timer(clock.now_ns())
        for fd in select.select(receiver.fds(), [], [], 0.01)[0]:
            yield from receiver.read_ready(fd)


def watch_movement(address: str, config: IngestConfig, seconds: float) -> tuple[Movement, int]:
    """The accepted poses of a car that is pushed for so long, and how many were rejected.

    Raises:
        SteerdError: the address is none, or no pose came from it.
    """
    clock, samples = MonotonicClock(), []
    try:
        receiver = make_receiver(parse_mocap_url(address), config)
    except ValueError as error:
        raise SteerdError(f"--mocap {address}: {error}", "", ExitCode.USAGE) from None
    except OSError as error:
        raise SteerdError(str(error), "steerd probe", ExitCode.UNREADABLE) from None
    with contextlib.closing(receiver):
        # Nobody pushes a car for a source that does not answer.
        if next(listen(receiver, clock, ANSWER_S), None):
            text = f"push the car straight forward by about 1 m within {seconds:g} s …"
            print(text, file=sys.stderr, flush=True)
            samples = list(listen(receiver, clock, seconds))
    good = [s for s in samples if s.rejected is None]
    if not good:
        what = f"no pose came from {address}: {receiver.status().detail}"
        raise SteerdError(what, f"steerd probe --mocap '{address}'", ExitCode.UNREADABLE)
    t0 = good[0].t_valid_ns
    rows = [((s.t_valid_ns - t0) * 1e-9, s.x, s.y, s.yaw, s.height, s.tilt) for s in good]
    return Movement(*np.array(rows).T), len(samples) - len(good)


def _seen(
    receiver: MocapReceiver, address: str, samples: Sequence[Pose], seconds: float
) -> MocapSeen:
    status = receiver.status()
    # The clock offset is not known well in the first second.
    age = np.array([(s.t_arrival_ns - s.t_valid_ns) * 1e-6 for s in samples[len(samples) // 3 :]])
    refused = Counter(s.rejected for s in samples if s.rejected)
    spread = np.quantile(age, (0.05, 0.5, 0.95)) if age.size else np.full(3, np.nan)
    placed = [s for s in samples if np.isfinite(s.height)]
    sigma = status.clock_sigma_ns
    return MocapSeen(
        address, status.server, status.bodies, status.detail, seconds,
        samples=len(samples),
        accepted=len(samples) - refused.total(),
        rate_hz=status.rate_hz,
        expected_rate_hz=status.expected_rate_hz,
        clock=status.clock.name.lower() if status.clock is not None else "",
        clock_sigma_ms=None if sigma is None else sigma * 1e-6,
        latency_ms=float(spread[1]) if age.size else None,
        jitter_ms=float(spread[2] - spread[0]) if age.size else None,
        height=float(np.median([s.height for s in placed])) if placed else None,
        tilt=float(np.median([s.tilt for s in placed])) if placed else None,
        refused=tuple(sorted(refused.items())),
    )  # fmt: skip


# -- this machine --------------------------------------------------------------------------------


def find_sockets(proc: Path = Path("/proc/net")) -> tuple[SocketFound, ...]:
    """Sockets in use, of TCP those that listen, on ports that zenoh, NatNet or VRPN use."""
    found: dict[SocketFound, None] = {}  # each once, in order
    for name in ("tcp", "udp", "tcp6", "udp6"):
        with contextlib.suppress(OSError):
            for line in (proc / name).read_text().splitlines()[1:]:
                _, local, _, state, *_ = line.split()
                kind, (host, _, port) = name.removesuffix("6"), local.partition(":")
                meaning = PORTS.get((kind, number := int(port, 16)))
                if meaning and (kind == "udp" or state == "0A"):
                    octets = bytes.fromhex(host)[::-1]
                    address = ".".join(map(str, octets)) if len(octets) == 4 else "::"
                    found[SocketFound(kind, address, number, meaning)] = None
    return tuple(found)


def in_dialout() -> bool:
    """Whether this user may open serial ports by group."""
    try:
        gid = grp.getgrnam("dialout").gr_gid
    except KeyError:
        return True
    return os.geteuid() == 0 or gid in os.getgroups()
