"""Bad files: bounded, without a traceback, never silently wrong."""

import io
import os
import struct
import tracemalloc
import zlib
from unittest.mock import Mock

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer  # noqa: TID251

from steerd.steer_bus.codec import encode
from steerd.steer_bus.container import MAGIC
from steerd.steer_bus.messages import WORLD, ClockSample, StateMessage, make_header
from steerd.steer_bus.session import recover
from steerd.steer_bus.session_read import SessionError, open_session
from tests.unit.steer_bus.conftest import refusal

pytestmark = pytest.mark.slow


def read_all(path):
    session = open_session(path)
    return session, [(r.topic, r.log_ns, r.data) for r in session.messages()]


def parts_of(session):
    info = session.info()
    return (info.metadata, [session.attachment(name) for name in info.attachments])


@pytest.fixture(scope="module")
def whole(drive):
    session, records = read_all(drive.path)
    return drive.path.read_bytes(), records, parts_of(session)


def write(path, *chunks):
    path.write_bytes(b"".join(chunks))
    return path


def read_written(folder, *chunks):
    return read_all(write(folder / "a.mcap", MAGIC, *chunks))


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value):
    raw = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(raw)) + raw


def chunk(data, compression="zstd", raw=None, size=None, crc=None):
    raw = zstandard.compress(data) if raw is None else raw
    head = (0, 0, len(data) if size is None else size, zlib.crc32(data) if crc is None else crc)
    body = text(compression) + struct.pack("<Q", len(raw)) + raw
    return record(6, struct.pack("<QQQI", *head) + body)


def channel(key=1, topic="/a", schema=1):
    return record(4, struct.pack("<HH", key, schema) + text(topic) + text("cdr") + text(b""))


def message(key=1, data=b"\0\1\0\0", log_ns=1):
    return record(5, struct.pack("<HIQQ", key, 1, log_ns, log_ns) + data)


KINDS = {
    "not finished": "unfinished", "unknown kind": "unknown_record", "defined twice": "conflict",
    "defined nowhere": "unknown_channel", "": "damaged",
}  # fmt: skip


def kinds(session):
    """What is wrong with a session, in a word each."""
    found = session.info().warnings
    return [next(kind for words, kind in KINDS.items() if words in text) for text in found]


def test_a_file_without_permission(tmp_path, monkeypatch):
    path, refuse = write(tmp_path / "a.mcap", MAGIC), Mock(side_effect=PermissionError(13, "no"))
    monkeypatch.setattr("pathlib.Path.open", refuse)
    assert refusal(open_session, path)[0] == "unreadable"


def test_truncation_keeps_everything_before_it(whole, tmp_path):
    data, records, _ = whole
    kept = []
    within_the_end = range(len(data) - 59, len(data), 3)
    for length in [*(len(data) * percent // 100 for percent in range(1, 99)), *within_the_end]:
        path = write(tmp_path / "a.mcap", data[:length])
        session, found = read_all(path)
        assert (found, kinds(session)[-1]) == (records[: len(found)], "unfinished")
        assert not session.info().clean
        kept.append(len(found))
    assert kept == sorted(kept)
    assert kept[-1] == len(records)


def test_bit_flips_are_detected_or_change_nothing(whole, tmp_path):
    data, records, parts = whole
    rng = np.random.default_rng(7)
    detected = 0
    for _ in range(150):
        bad = bytearray(data)
        bad[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        try:
            session, found = read_all(write(tmp_path / "a.mcap", bytes(bad)))
        except SessionError:
            detected += 1
            continue
        if session.info().warnings:
            detected += 1
            remaining = iter(records)
            assert all(item in remaining for item in found)
        else:
            assert (found, parts_of(session)) == (records, parts)
    assert detected > 100


def test_recovery_saves_what_reading_finds(whole, tmp_path):
    data = whole[0]
    bad = write(tmp_path / "bad.mcap", data[: len(data) * 7 // 10])
    _, found = read_all(bad)
    damaged = open_session(bad)
    assert recover(damaged, tmp_path / "good.mcap") == pytest.approx(0.005)
    session, saved = read_all(tmp_path / "good.mcap")
    assert saved == found
    assert damaged.info().lost > 0
    info = session.info()
    assert (info.count, info.warnings) == (len(found), [])
    assert info.finished
    assert not info.clean
    assert info.metadata["steerd.recovered"]["source"] == "bad.mcap"
    assert session.attachment("car.toml") == b"mass_kg = 3.1\n"
    states = sum(topic.endswith("/state") for topic, _, _ in found)
    assert session.columns(StateMessage)["x"].shape[0] == states


def test_a_bomb_is_refused_cheaply(tmp_path):
    bomb = zstandard.compress(bytes(60 << 20), 3)
    small = zstandard.compress(bytes(3 << 20), 3)
    liar = chunk(b"", raw=zstandard.compress(bytes(60 << 20)), size=1000)
    maker = lz4.frame.LZ4FrameCompressor()  # its frame does not say how much it unpacks to
    silent = chunk(b"", "lz4", maker.begin() + maker.compress(bytes(60 << 20)) + maker.flush(), 999)
    sizes = ((bomb, 60 << 20), (small, 3 << 20), (bomb, 1 << 50))
    bad = [*(chunk(b"", raw=raw, size=size) for raw, size in sizes), liar, silent]
    tracemalloc.start()
    session, found = read_written(tmp_path, *bad, chunk(channel() + message()))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (kinds(session), len(found)) == (["damaged"] * 5 + ["unfinished"], 1)
    assert peak < 10 << 20


@pytest.mark.parametrize("bad", [
    chunk(message(), crc=1), chunk(message(), "brotli"), chunk(message(), "lz4"),
    chunk(message(), raw=b"\x28\xb5\x2f\xfd rubbish"),
    chunk(message(), raw=zstandard.compress(message())[:-3]), chunk(b"\5\xff\0"),
    chunk(record(5, b"short")), chunk(record(4, b"")),
    chunk(record(4, struct.pack("<HH", 3, 1) + text(b"\xff\xfe") + text("") + text(b""))),
    chunk(struct.pack("<BQH", 5, 1 << 62, 1) + bytes(40)), record(7, b"no index at all"),
    record(11, bytes(46)), record(9, bytes(10)), record(12, text("name") + text(b"odd")),
    record(0, b""), record(15, b"12345"), struct.pack("<BQ", 6, 1 << 63),
])  # fmt: skip
def test_a_bad_record_does_not_hide_the_next(tmp_path, bad):
    session, found = read_written(tmp_path, bad, chunk(channel() + message(data=b"abc")))
    assert (kinds(session), [data for _, _, data in found]) == (["damaged", "unfinished"], [b"abc"])


def test_unknown_records_messages_of_no_channel_and_channels_of_two_minds_or_too_many(tmp_path):
    session, _ = read_written(tmp_path, record(0x90, b"private"), chunk(channel() + message()))
    assert kinds(session) == ["unknown_record", "unfinished"]
    body = channel() + channel(topic="/b") + message() + message(key=9)
    session, found = read_written(tmp_path, chunk(body))
    assert kinds(session) == ["conflict", "unfinished", "unknown_channel"]
    assert [topic for topic, _, _ in found] == ["/a"]
    body = b"".join(channel(key, f"/t{key}") for key in range(5000))
    session, _ = read_written(tmp_path, chunk(body))
    assert kinds(session)[0] == "damaged"
    assert len(session.info().topics) <= 4096


def test_a_sparse_giant_is_left_at_once(tmp_path):
    path = write(tmp_path / "a.mcap", MAGIC, chunk(channel() + message()))
    os.truncate(path, 50 << 30)
    session, found = read_all(path)
    assert (kinds(session), len(found)) == (["unfinished"], 1)


def test_schemas_of_a_lost_first_chunk_come_from_the_summary(whole, tmp_path):
    data, records, _ = whole
    start = data.index(b"\x06", data.index(b"mass_kg = 3.1\n"))
    bad = bytearray(data)
    bad[start + 200] ^= 0xFF
    session, found = read_all(write(tmp_path / "a.mcap", bytes(bad)))
    assert (kinds(session)[0], found) == ("damaged", records[-len(found) :])
    assert session.columns(StateMessage)["x"].size > 0


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_other_writers_files_are_read(tmp_path, compression, chunked):
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=compression, use_chunking=chunked)
    writer.start()
    schema = writer.register_schema("x/msg/Strange", "jsonschema", b"{}")
    strange = writer.register_channel("/strange", "json", schema)
    bare = writer.register_channel("/bare", "json", 0)
    for i in range(100):
        writer.add_message(strange if i % 2 else bare, 100 - i, b"{}", 0)
    writer.finish()
    session, found = read_all(write(tmp_path / "a.mcap", buffer.getvalue()))
    assert session.info().warnings == []
    assert [log_ns for _, log_ns, _ in found] == list(range(100, 0, -1))
    assert (session.info().start_ns, session.info().end_ns) == (1, 100)
    recover(session, tmp_path / "b.mcap")
    assert open_session(tmp_path / "b.mcap").info().count == 100
    assert refusal(session.columns, ClockSample, "/strange")[0] == "other_schema"


def test_a_drive_of_another_version_names_the_fields(tmp_path):
    writer = Writer(buffer := io.BytesIO())
    writer.start("ros2")
    old = b"std_msgs/Header header\nint64 realtime_ns\nint64 monotonic_ns\nint64 drift\n"
    schema = writer.register_schema("steerd_msgs/msg/ClockSample", "ros2msg", old)
    data = encode(ClockSample(make_header(0, WORLD), 1, 2, 3))
    writer.add_message(writer.register_channel("/c", "cdr", schema), 1, data, 1)
    writer.finish()
    session = open_session(write(tmp_path / "a.mcap", buffer.getvalue()))
    with pytest.raises(SessionError, match=r"mocap_offset_ns.*drift"):
        session.columns(ClockSample)
