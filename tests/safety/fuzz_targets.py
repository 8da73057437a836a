"""What is fuzzed: everything that reads bytes which another program or a broken wire has made.

An input is a script of pieces, so that a fuzzer gets behind checksums and lengths: each piece is an
operation, a length and a body. A target turns the pieces into bytes, feeds them, and raises
whatever is wrong. The first byte of a script chooses a version where there are some.
"""

import math
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import zstandard

from steerd.daemon.ipc.requests import pack_request, unpack_request
from steerd.daemon.loop.lease import Lease, Remote, accept_request, take_command
from steerd.daemon.loop.outgoing import make_mocap
from steerd.daemon.loop.transitions import Fact
from steerd.mocap_link import natnet, vrpn
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import NatNetSource
from steerd.mocap_link.natnet_wire import Frame, NatNetError, RigidBody
from steerd.mocap_link.vrpn_client import VrpnSource
from steerd.mocap_link.zenoh_pose import BusPoseSource, PoseError, decode_pose, decode_ros_pose
from steerd.sim_hw.mocap.servers import VrpnServer
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.container import MAGIC, RECORD
from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import MESSAGE_TYPES, SessionError, open_session
from steerd.vesc_link import commands as c
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.frames import MAX_PAYLOAD, FrameParser, encode_frame
from steerd.vesc_link.identity import AppConf, FwVersion
from steerd.vesc_link.ids import PROFILES, Firmware
from steerd.vesc_link.packets import decode_command, decode_reply, encode_command, encode_reply
from steerd.vesc_link.scaling import F1TENTH
from steerd.vesc_link.vesc import WRITE_LIMIT, Answer, Drive, VescLink
from tests.ros_messages import POSE, pack_pose

MS = 1_000_000
VERSIONS = ((2, 9), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2))
FIRMWARE = (Firmware(2, 18), *PROFILES)
CLASSES = tuple(MESSAGE_TYPES[name] for name in sorted(MESSAGE_TYPES))
BOOT = 0x0123_4567_89AB_CDEF
HELD = MAX_PAYLOAD + 6
SERVER = "10.0.0.1"
LOSSY = c.SetMcConfTemp  # a command with flags that are any byte: it need not come back
MOST = 4096  # more bytes than this from one input only take time

Piece = tuple[int, bytes]


@dataclass(frozen=True)
class Target:
    """One thing to fuzz: raises on what must not be; good inputs to begin with."""

    check: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]


def cut(script: bytes) -> Iterator[Piece]:
    """The pieces of a script; a length beyond the end takes what is left."""
    at = 1
    while at + 3 <= len(script):
        size = int.from_bytes(script[at + 1 : at + 3], "little") % (MOST + 1)
        yield script[at], script[at + 3 : at + 3 + size]
        at += 3 + size


def glue(choice: int, *pieces: Piece) -> bytes:
    parts = [bytes((op,)) + len(body).to_bytes(2, "little") + body for op, body in pieces]
    return bytes((choice,)) + b"".join(parts)


def flip(data: bytes, body: bytes) -> bytes:
    """One bit of a frame turned over; where, the body says."""
    at = sum(body) % (8 * len(data))
    return data[: at // 8] + bytes((data[at // 8] ^ 1 << at % 8,)) + data[at // 8 + 1 :]


def all_finite(value: Any) -> bool:
    """Whether no number of a decoded value is NaN or infinite."""
    if is_dataclass(value) and not isinstance(value, type):
        return all(all_finite(item) for item in asdict(value).values())
    return not isinstance(value, float) or math.isfinite(value)


# --- the serial port


def check_frames(script: bytes) -> None:
    """Any bytes: bounded memory, only frames that were there, and good ones found again."""
    host, firmware, sent, t_ns = FrameParser(), FrameParser(strict=True), b"", 0
    strict: list[bytes] = []
    for op, body in cut(script):
        data = choose(op, body)
        t_ns += 10 * MS * len(body) if op % 4 == 3 else MS
        if len(sent) + len(data) > MOST:
            break
        sent += data
        found = host.feed(data, t_ns)
        assert all(encode_frame(payload) in sent or long(payload) in sent for payload in found)
        strict += firmware.feed(data, t_ns)
        assert max(host.buffered, firmware.buffered) <= HELD
    assert strict == FrameParser(strict=True).feed(sent, 0)
    for parser in (host, firmware):
        parser.feed(bytes(HELD + 2), t_ns)
        assert parser.feed(encode_frame(b"\4good"), t_ns) == [b"\4good"]


def choose(op: int, body: bytes) -> bytes:
    """The bytes of a piece: as they are, in a frame, in a damaged frame, none."""
    framed = encode_frame(body[:MAX_PAYLOAD] or b"\4")
    return (body, framed, flip(framed, body), b"")[op % 4]


def long(payload: bytes) -> bytes:
    """A frame with a two-byte length, which 255 bytes may have."""
    frame = encode_frame(payload)
    return b"\x03\x00" + frame[1:] if len(payload) == 255 else frame


def check_packets(script: bytes) -> None:
    """Any payload: decoded or refused, finite, and a command the same again after encoding it."""
    if not script:
        return
    fw = FIRMWARE[script[0] % len(FIRMWARE)]
    command, reply = decode_command(script[1:], fw), decode_reply(script[1:], fw)
    assert all_finite(command)
    assert all_finite(reply)
    if command is not None and not isinstance(command, LOSSY):
        assert decode_command(encode_command(command, fw), fw) == command


def check_vesc(script: bytes) -> None:
    """A client with open requests: any bytes at any time, and each tick one packet."""
    link, t_ns = VescLink(F1TENTH), 0
    firmware = PROFILES[(script[0] if script else 0) % len(PROFILES)]
    link.make_connect(0)
    link.on_bytes(1, encode_frame(encode_reply(FwVersion(*firmware, "60", bytes(12)), firmware)))
    for op, body in cut(script[:MOST]):
        t_ns += 5 * MS
        for event in link.on_bytes(t_ns, choose(op, body)):
            assert not isinstance(event, Answer) or all_finite(event.reply)
        if op % 4 == 3:
            speed, steer = struct.unpack("<ff", body[:8].ljust(8, b"\0"))
            try:
                wire = link.make_tick(Drive(ActuationMode.SPEED, steer, speed), t_ns)
            except ValueError:
                assert not (math.isfinite(speed) and math.isfinite(steer))
                wire = link.make_tick(Drive(ActuationMode.BRAKE, current=5.0), t_ns)
            assert len(wire) <= WRITE_LIMIT
            link.make_connect(t_ns)
        assert link.parser.buffered <= HELD


def serial_seeds() -> list[bytes]:
    """Frames of all kinds, whole and cut, and clients that talk."""
    values = t.Values(motor_current=1.0, erpm=4000.0, tachometer=5, tachometer_abs=5, status=0)
    fw = PROFILES[-1]
    replies = (
        values, t.Imu(t.IMU_ACCEL_GYRO_MASK, gyro_z=0.1), FwVersion(*fw, "60", bytes(12)),
        AppConf(1, 1, 150, 20.0),
    )  # fmt: skip
    payloads = [encode_reply(reply, fw) for reply in replies]
    payloads += [encode_command(command) for command in (c.SetErpm(4000.0), c.GetValues())]
    whole = glue(6, *((1, payload) for payload in payloads))
    talk = glue(6, *((op, body) for body in payloads for op in (3, 1)))
    odd = glue(3, (0, b"\2\5\4"), (1, bytes(255)), (3, b"\1\2"), (2, payloads[0]), (1, bytes(512)))
    return [whole, talk, odd, *(bytes((7,)) + payload for payload in payloads)]


# --- mocap


def check_natnet(script: bytes) -> None:
    """Any datagram: `NatNetError` or a message, and a frame is the same after encoding it."""
    if len(script) < 2:
        return
    version, data = VERSIONS[script[0] % len(VERSIONS)], script[1 : MOST + 1]
    if script[0] & 0x80:
        data = data[:2] + struct.pack("<H", max(0, len(data) - 4)) + data[4:]
    try:
        message = natnet.decode(data, version)
    except NatNetError:
        return
    if isinstance(message, Frame):
        again = natnet.decode(natnet.encode(message, version), version)
        assert repr(again) == repr(message)


def check_natnet_client(script: bytes) -> None:
    """A client with a session: any datagrams on both sockets, timers between."""
    client, t_ns = NatNetSource("car", SERVER, IngestConfig()), 0
    version = VERSIONS[(script[0] if script else 0) % len(VERSIONS)]
    client.on_datagram(make_hello(version), 0, SERVER)
    for op, body in cut(script[:MOST]):
        t_ns += 10 * MS
        data = body
        if op & 4:
            data = body[:2].ljust(2, b"\0") + struct.pack("<H", len(body[2:])) + body[2:]
        if op & 3 == 3:
            t_ns += 100 * MS * len(body)
            assert len(client.on_timer(t_ns)) < 10
        which = "data" if op & 1 else "command"
        for pose in client.on_datagram(data, t_ns, SERVER, which):
            assert pose.body == "car"
            encode(make_mocap(pose, 0))
    assert client.detail


def make_hello(version: tuple[int, int]) -> bytes:
    """The server's answer that begins a session."""
    info = natnet.ServerInfo("S", (1, 0, 0, 0), (*version, 0, 0), 1000 if version[0] > 2 else 0)
    return natnet.encode(info, version)


def check_vrpn(script: bytes) -> None:
    """Any stream in any chunks: never raises, gives the same poses as in one piece."""
    client, parts, got = VrpnSource("car", IngestConfig()), [], []
    for op, body in cut(script[:MOST]):
        kind = int.from_bytes(body[:1], "big", signed=True)
        message = vrpn.Message(kind, *body[1:2].ljust(1, b"\0"), payload=body[2:])
        piece = (vrpn.COOKIE, vrpn.encode(message), body, body[:1])[op % 4]
        parts.append(flip(piece, body) if op & 16 and piece else piece)
        got += client.on_bytes(parts[-1], len(parts))
        assert len(client._stream._buffer) <= vrpn.MAX_MESSAGE + 8 or client.dead
    whole = VrpnSource("car", IngestConfig())
    once = whole.on_bytes(b"".join(parts), 1)
    assert (whole.dead is None) == (client.dead is None)
    if client.dead is None:
        assert [repr(pose.position) for pose in once] == [repr(pose.position) for pose in got]


def check_pose(data: bytes) -> None:
    """Any bytes on a pose topic: `PoseError` or a pose, which a message can hold."""
    for decode_bytes in (decode_pose, decode_ros_pose):
        source = BusPoseSource(IngestConfig(), decode_bytes)
        try:
            decode_bytes(data, 0)
        except PoseError:
            assert source.on_message(data, 0) is None
            continue
        sample = source.on_message(data, 0)
        assert sample is not None
        encode(make_mocap(sample, 0))


def natnet_seeds() -> list[bytes]:
    """Frames, models and talk of each version."""
    body = RigidBody(1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    model = natnet.ModelDef((natnet.RigidBodyDesc("car", 1),))
    seeds = []
    for k, version in enumerate(VERSIONS):
        frame, names = natnet.encode(Frame(5, (body,)), version), natnet.encode(model, version)
        seeds += [bytes((k,)) + data for data in (frame, names, make_hello(version))]
        talk = ((0, names), (1, frame), (3, b""), (0, natnet.encode(natnet.EchoResponse(1, 2))))
        seeds.append(glue(k, *talk, (0, natnet.encode(natnet.Bare.DISCONNECT)), (1, frame)))
    return seeds


def vrpn_seeds() -> list[bytes]:
    """A session as pieces, and as one run of bytes."""
    server = VrpnServer(("car",))
    pose = server.pose("car", 1, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    name = vrpn.make_description(vrpn.TYPE_DESCRIPTION, 1, vrpn.POSE_TYPE)
    payload = bytes((0xFE, 1)) + name.payload
    return [
        glue(0, (2, server.hello()), (2, pose), (3, pose), (2, pose)),
        glue(0, (0, b""), (1, payload)),
    ]


def pose_seeds() -> list[bytes]:
    """Poses as JSON, and one of a ROS node."""
    good = b'{"v":1,"body":"car","t_src_ns":5,"seq":7,"p":[1,2,3],"q":[1,0,0,0],"valid":true}'
    odd = [good.replace(b"5", n) for n in (b"-5", b"9223372036854775807", b"1" + b"0" * 400)]
    ros = pack_pose(POSE, 5, (1.0, 2.0, 0.1), (1.0, 0.0, 0.0, 0.0), "map")
    return [good, good.replace(b"5", b"null"), good.replace(b"7", b"9223372036854775808"), *odd,
            b"[" * 200, ros]  # fmt: skip


# --- messages, requests, sessions


def check_codec(script: bytes) -> None:
    """Any CDR: `CodecError` or a message that is the same after encoding it."""
    if not script:
        return
    cls = CLASSES[script[0] % len(CLASSES)]
    try:
        message = decode(cls, script[1:])
    except CodecError:
        return
    assert repr(decode(cls, encode(message))) == repr(message)


def check_requests(script: bytes) -> None:
    """Any requests: without this run's boot id and a rising number only a stop is accepted."""
    lease, remote, t_ns = Lease(BOOT), Remote(Lease(BOOT)), 0
    taken: dict[int, int] = {}
    for op, body in cut(script[:MOST]):
        t_ns += 50 * MS
        name, data = unpack_request(body if op & 1 else pack_request(NAMES[op // 2 % 2], body))
        try:
            if name == topics.OPERATOR.name:
                message = decode(m.OperatorRequest, data)
                idle, before = bool(op & 4), lease
                lease, request = accept_request(lease, message, t_ns, idle)
                ours = message.boot_id == BOOT and message.lease_id != 0
                rises = message.lease_id != before.holder or message.seq > before.seq
                free = idle or message.lease_id == before.holder
                if not (ours and rises and free):
                    assert request in (0, Fact.STOP, Fact.CALL_ESTOP, Fact.UNKNOWN)
                    assert lease.renewed_ns == before.renewed_ns
                if lease.renewed_ns == t_ns:
                    assert message.seq > taken.get(message.lease_id, -1)
                    taken[message.lease_id] = message.seq
            elif name == topics.DRIVE.name:
                command = decode(m.DriveCommand, data)
                old, remote = remote, take_command(remote, command, t_ns)
                good = command.boot_id == BOOT and 0 < command.valid_ms <= 300
                assert good or remote.command is old.command
        except CodecError:
            continue


NAMES = (topics.OPERATOR.name, topics.DRIVE.name)


def request_seeds() -> list[bytes]:
    """What operators and controllers say, also old and foreign."""
    head = m.make_header(0, m.BODY)
    said = [encode(m.OperatorRequest(head, BOOT, 7, k, k % 9, "desk")) for k in range(9)]
    drives = [encode(m.DriveCommand(head, BOOT, 9, 1, k, 200, 0.1, 1.0)) for k in range(3)]
    talk = [(4, said[1]), *((0, data) for data in said[2:]), *((2, data) for data in drives)]
    packet = (1, pack_request(NAMES[0], said[3]))
    return [glue(0, *talk), glue(0, (4, said[5]), (0, said[3]), packet), *codec_seeds()]


def codec_seeds() -> list[bytes]:
    """One message of a few kinds, behind the number of its class."""
    head = m.make_header(1, m.BODY)
    some = (
        m.ClockSample(head, 1, 2, 0), m.Tick(head, 1, 2, 3, 4, 5),
        m.OperatorRequest(head, BOOT, 7, 1, 1, "desk"),
        m.VescIdentity(head, 1, 150, 1, 6, 5, 20.0, "00"),
    )  # fmt: skip
    return [bytes((CLASSES.index(type(one)),)) + encode(one) for one in some]


SHELF = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(tempfile.gettempdir())


def check_session(script: bytes) -> None:
    """Any file: `SessionError`, or records that decode or say `CodecError`; bounded by its size."""
    with tempfile.TemporaryDirectory(dir=SHELF) as folder:
        path = Path(folder) / "drive.mcap"
        path.write_bytes(make_file(script))
        try:
            session = open_session(path)
            for record in session.messages():
                with suppress(CodecError):
                    record.decode()
            for name in session.info().attachments:
                session.attachment(name)
            session.columns(m.ClockSample)
        except SessionError:
            return


def make_file(script: bytes) -> bytes:
    """A container of these pieces: raw bytes, records, and chunks whose CRCs are right."""
    out, inner = bytearray(MAGIC if script[:1] != b"\xff" else b""), b""
    for op, body in cut(script):
        record = RECORD.pack(body[0], len(body) - 1) + body[1:] if body else b""
        match op % 5:
            case 0:
                out += body
            case 1:
                out += record
            case 2:
                inner += record
            case 3:
                out += make_chunk(inner, body)
                inner = b""
            case _:
                out += RECORD.pack(0x0F, 4) + bytes(4) + body
                out += RECORD.pack(2, 20) + bytes(20) + MAGIC
    return bytes(out)


def make_chunk(inner: bytes, body: bytes) -> bytes:
    """A chunk record with a CRC that fits; the body's first byte packs it, the next lie."""
    packed = bool(body[:1]) and body[0] & 1
    raw = zstandard.compress(inner) if packed else inner
    size = len(inner) + int.from_bytes(body[1:9], "little") * bool(body[:1] and body[0] & 2)
    name = b"zstd" if packed else b""
    head = struct.pack("<QQQI", 0, 0, size & (1 << 64) - 1, zlib.crc32(inner))
    head += struct.pack("<I", len(name)) + name + struct.pack("<Q", len(raw))
    return RECORD.pack(6, len(head) + len(raw)) + head + raw


def session_seeds() -> list[bytes]:
    """A small session as its own bytes, and as pieces."""
    with tempfile.TemporaryDirectory(dir=SHELF) as folder:
        path = Path(folder) / "drive.mcap"
        topic = topics.CLOCK.name
        writer = SessionWriter(path, {topic: m.ClockSample}, {"steerd.session": {"a": "b"}})
        for k in range(5):
            data = encode(m.ClockSample(m.make_header(k, m.BODY), k, k, 0))
            writer.write(topic, data, k + 1)
        data = writer.finish({"why": "done"}).read_bytes()
    records = list(take_apart(1, data[len(MAGIC) : -len(MAGIC)]))
    chunk = next(body for _, body in records if body[0] == 6)
    loose = list(take_apart(2, zstandard.decompress(chunk[chunk.index(b"zstd") + 12 :])))
    packed = glue(0, *loose, (3, b"\1"), *loose, (3, b""), (4, b""))
    return [glue(255, (0, data)), glue(0, *records), packed]


def take_apart(piece: int, data: bytes) -> Iterator[Piece]:
    """The records of a container as pieces."""
    at = 0
    while at < len(data):
        op, size = RECORD.unpack_from(data, at)
        at += RECORD.size + size
        yield piece, bytes((op,)) + data[at - size : at]


TARGETS = {
    "frames": Target(check_frames, serial_seeds),
    "packets": Target(check_packets, serial_seeds),
    "vesc": Target(check_vesc, serial_seeds),
    "natnet": Target(check_natnet, natnet_seeds),
    "natnet_client": Target(check_natnet_client, natnet_seeds),
    "vrpn": Target(check_vrpn, vrpn_seeds),
    "pose": Target(check_pose, pose_seeds),
    "codec": Target(check_codec, codec_seeds),
    "requests": Target(check_requests, request_seeds),
    "session": Target(check_session, session_seeds),
}
