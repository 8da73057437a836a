"""Bad containers through `steerd info` and `recover`: one line, the right exit code, no traceback.

The numbers are those of `docs/reference/safety-requirements.md#s9.1`, 1 to 24.
"""

import os
import struct
import zlib

import pytest
import zstandard

from steerd.daemon.imports.import_session import MessageMaker
from steerd.steer_bus.codec import encode
from steerd.steer_bus.fields import schema_text
from steerd.steer_bus.messages import MocapPose
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session
from tests.unit.daemon.sessions.test_bad_content import steerd

pytestmark = pytest.mark.slow

MAGIC = b"\x89MCAP0\r\n"
TOPIC = "/steerd/blue/mocap"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    writer = SessionWriter(path, {TOPIC: MocapPose}, {"steerd.session": {"car": "blue"}})
    maker = MessageMaker(0)
    for i in range(300):
        pose = maker.planar_pose(i * 10_000_000, 0.01 * i, 0.0, 0.0)
        writer.write(TOPIC, encode(pose), i * 10_000_000)
        writer.tick(i * 10_000_000)
    return writer.finish({"reason": "end"}).read_bytes()


def put(path, *parts):
    path.write_bytes(b"".join(parts))
    return path


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value):
    raw = value.encode()
    return struct.pack("<I", len(raw)) + raw


def chunk(data, *, raw=None, size=None, crc=None, compression="zstd"):
    raw = zstandard.compress(data) if raw is None else raw
    head = (0, 0, len(data) if size is None else size, zlib.crc32(data) if crc is None else crc)
    body = struct.pack("<QQQI", *head) + text(compression) + struct.pack("<Q", len(raw)) + raw
    return record(6, body)


def schema(key=1):
    name, layout = text("steerd_msgs/msg/MocapPose"), text(schema_text(MocapPose))
    return record(3, struct.pack("<H", key) + name + text("ros2msg") + layout)


def channel(key=1, topic=TOPIC, schema_id=1):
    return record(4, struct.pack("<HH", key, schema_id) + text(topic) + text("cdr") + text(""))


def message(key=1, log_ns=1, data=None):
    data = encode(MessageMaker(0).planar_pose(0, 0.0, 0.0, 0.0)) if data is None else data
    return record(5, struct.pack("<HIQQ", key, 1, log_ns, log_ns) + data)


def header():
    return MAGIC + record(1, text("ros2") + text("test"))


GOOD = (schema(), channel(), message())


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [
        (b"", 3, "is empty"),  # 1
        (MAGIC, 4, "holds no session"),  # 2
        (b"\x89MCAP1\r\n" + bytes(50), 3, "not an MCAP file"),  # 3
        (b"t,x\n0,1\n", 3, "not an MCAP file"),  # 4
        (b"PK\x03\x04" + bytes(50), 3, "not an MCAP file"),
        (b"SQLite format 3\x00" + bytes(50), 3, "not an MCAP file"),
        (MAGIC + struct.pack("<BQ", 6, 1 << 63), 4, "holds no session"),  # 12
    ],
    ids=["empty", "magic", "other_magic", "text", "zip", "sqlite", "endless"],
)
@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_session(tmp_path, command, content, code, words):
    found, out, err = steerd(command, put(tmp_path / "a.mcap", content))
    assert (found, out) == (code, "")
    assert words in err
    assert list(tmp_path.iterdir()) == [tmp_path / "a.mcap"]


@pytest.mark.parametrize("command", ["info", "recover"])
def test_what_is_no_file(tmp_path, command):
    os.mkfifo(tmp_path / "fifo")
    for name in ("", "fifo", "none"):  # 22, 23
        code, out, err = steerd(command, tmp_path / name)
        assert (code, out) == (3, "")
        assert err.startswith("steerd: ")


def test_truncation_at_each_percent(whole, tmp_path):  # 5, 6
    saved = []
    for percent in range(1, 100):
        path = put(tmp_path / "a.mcap", whole[: len(whole) * percent // 100])
        code, out, _ = steerd("info", path, "--json") if percent % 9 else steerd("info", path)
        assert code in (0, 4)
        code, out, err = steerd("recover", path)
        assert (code == 0) == ("saved" in out)
        assert code in (0, 4)
        if code == 0:
            assert "warning: " in err
            recovered = tmp_path / "a.recovered.mcap"
            saved.append(open_session(recovered).info().count)
            assert not open_session(recovered).warnings
            recovered.unlink()
    assert saved == sorted(saved)
    assert saved[-1] == 300


def test_a_hundred_thousand_channels(tmp_path):  # 19
    names = b"".join(channel(key % 65536, f"/steerd/c/{key}") for key in range(100_000))
    path = put(tmp_path / "a.mcap", header(), chunk(b"".join(GOOD)), chunk(names))
    code, out, _ = steerd("info", path)
    assert code == 0
    assert len(out.splitlines()) < 40


def test_messages_that_are_not_their_schema_are_named(tmp_path):
    data = b"".join([schema(), channel(), message(data=b"\x00\x01\x00\x00junk"), message()])
    code, _, err = steerd("info", put(tmp_path / "a.mcap", header(), chunk(data)))
    assert code == 0
    assert "not what its schema says" in err


def test_a_whole_file_needs_no_recovery(whole, tmp_path):
    code, out, _ = steerd("recover", put(tmp_path / "a.mcap", whole))
    assert code == 0
    assert "nothing to recover" in out
    assert len(list(tmp_path.iterdir())) == 1


def test_recovery_names_its_file(whole, tmp_path):
    path = put(tmp_path / "a.mcap.partial", whole[:-100])
    assert steerd("recover", path)[0] == 0
    assert (tmp_path / "a.recovered.mcap").exists()
    code, _, err = steerd("recover", path)
    assert code == 2
    assert "never overwritten" in err
    assert steerd("recover", path, "-o", tmp_path / "b.mcap")[0] == 0
    assert steerd("recover", path, "-o", tmp_path / "b.txt")[0] == 2
    assert steerd("recover", path, "-o", tmp_path / "no" / "b.mcap")[0] == 3
    _, out, _ = steerd("info", tmp_path / "b.mcap")
    assert "recovered from a.mcap.partial" in out
