"""A session comes back as it was written: columns, recorded order, texts, names."""

import dataclasses
import io
import shutil
from operator import attrgetter

import numpy as np
import pytest
from mcap.reader import make_reader  # noqa: TID251
from mcap.writer import Writer  # noqa: TID251
from mcap_ros2.decoder import DecoderFactory

from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.container_write import ContainerWriter
from steerd.steer_bus.fields import flat_leaves
from steerd.steer_bus.messages import OWN_MESSAGES, WORLD, StateMessage, make_header
from steerd.steer_bus.session import SessionWriter, recover
from steerd.steer_bus.session_read import SessionError, open_session
from steerd.steer_bus.standard import DiagnosticArray, Odometry
from tests.blank import drawn
from tests.unit.steer_bus.conftest import TOPIC_OF, refusal


def start(path, **topics):
    return SessionWriter(path, {f"/{name}": cls for name, cls in topics.items()}, {})


def recorded(path, cls, messages):
    """The session of encoded messages of one topic."""
    writer = start(path, topic=cls)
    for i, message in enumerate(messages):
        writer.write("/topic", message, i)
    return open_session(writer.finish({}))


def clock(i, frame=WORLD):
    return encode(m.ClockSample(make_header(i, frame), i, i, i))


def test_info(drive):
    session = open_session(drive.path)
    info = session.info()
    assert (info.count, info.warnings) == (len(drive.order), [])
    assert info.finished
    assert info.clean
    assert info.metadata["steerd.session"] == {"schema_version": "1", "car": "car1"}
    assert (info.metadata["steerd.end"], info.attachments) == ({"reason": "test"}, ("car.toml",))
    assert next(session.attachments()).media_type == "application/toml"
    assert info.duration_s == pytest.approx(0.995)
    assert all(topic.rate_hz == pytest.approx(200.0) for topic in info.topics)
    assert not drive.path.with_name("drive.mcap.partial").exists()


def test_messages_come_in_recorded_order(drive):
    records = list(open_session(drive.path).messages())
    assert [(r.topic, r.data) for r in records] == drive.order
    assert all(r.publish_ns == r.log_ns - 1000 for r in records)
    state = [r for r in records if r.topic.endswith("/state")]
    assert [r.sequence for r in state] == list(range(1, len(state) + 1))
    assert [r.decode() for r in state] == drive.messages[state[0].topic]
    assert list(open_session(drive.path).messages(state[0].topic)) == state


def test_other_peoples_tools_open_it_and_decode_every_message(drive):
    with drive.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages(log_time_order=False))
        assert reader.get_header().profile == "ros2"
    assert {schema.encoding for schema, *_ in found} == {"ros2msg"}
    assert [(channel.topic, raw.data) for _, channel, raw, _ in found] == drive.order
    for topic, ours in drive.messages.items():
        theirs = [message for _, channel, _, message in found if channel.topic == topic]
        for leaf in flat_leaves(type(ours[0])):
            of = attrgetter(leaf.name)
            assert [of(message) for message in theirs] == [of(message) for message in ours]


@pytest.mark.parametrize("cls", OWN_MESSAGES)
def test_columns_hold_every_value(drive, cls):
    columns = open_session(drive.path).columns(cls)
    messages = drive.messages[TOPIC_OF[cls]]
    assert len(columns["log_ns"]) == len(messages)
    for leaf in flat_leaves(cls)[3:]:
        assert columns[leaf.name].tolist() == [getattr(each, leaf.name) for each in messages]
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in messages]
    assert columns["stamp_ns"].tolist() == stamps


def test_log_time_never_goes_back_and_a_topic_without_messages_has_empty_columns(tmp_path):
    columns = recorded(tmp_path / "b.mcap", StateMessage, []).columns(StateMessage)
    assert (columns["x"].shape, columns["x"].dtype) == ((0,), np.float64)
    writer = start(tmp_path / "a.mcap", clock=m.ClockSample)
    for log_ns in (5, 3, 9, -1, 1 << 70):
        writer.write("/clock", clock(0), log_ns, log_ns)
    columns = open_session(writer.finish({})).columns(m.ClockSample)
    assert columns["log_ns"].tolist() == [5, 5, 9, 9, (1 << 63) - 1]
    assert columns["publish_ns"].tolist() == [5, 3, 9, 0, (1 << 63) - 1]


def test_a_killed_writer_loses_a_quarter_second_and_a_sync_is_due_each_second(tmp_path):
    writer = start(tmp_path / "a.mcap", clock=m.ClockSample)
    for i in range(9):
        writer.write("/clock", clock(i), i)
        assert writer.tick(i * 125_000_000) == (i % 8 == 0)
        assert open_session(writer.partial).info().count == i + 1 - i % 2
    writer.sync()
    writer.abandon()


def test_names_are_never_overwritten(tmp_path, drive):
    path = tmp_path / "a.mcap"
    writer = start(path)
    assert refusal(start, path)[0] == "exists"
    path.write_bytes(b"somebody's")
    with pytest.raises(SessionError, match="cannot be written"):
        writer.finish({})
    assert path.read_bytes() == b"somebody's"
    assert refusal(start, path)[0] == "exists"
    assert refusal(recover, open_session(drive.path), path)[0] == "exists"


def test_missing_folders_and_undeclared_topics(tmp_path):
    assert refusal(start, tmp_path / "none" / "a.mcap")[0] == "disk"
    writer = start(tmp_path / "a.mcap")
    with pytest.raises(KeyError):
        writer.write("/nothing", b"", 0)
    writer.abandon()


def test_what_a_session_lacks_is_said(drive):
    session = open_session(drive.path)
    assert refusal(session.columns, StateMessage, "/nothing") == ("missing_topic", 4)
    assert refusal(session.columns, Odometry) == ("missing_topic", 4)
    assert refusal(session.columns, StateMessage, TOPIC_OF[m.Tick]) == ("other_schema", 4)
    assert refusal(session.attachment, "x") == ("missing_attachment", 4)
    assert session.attachment("car.toml") == b"mass_kg = 3.1\n"
    with pytest.raises(TypeError, match="messages"):
        session.columns(DiagnosticArray, "/x")


def test_a_file_that_shrinks_while_it_is_read(tmp_path, drive):
    path = shutil.copy(drive.path, tmp_path / "a.mcap")
    session = open_session(path)
    path.write_bytes(path.read_bytes()[:200])
    assert refusal(session.columns, StateMessage)[0] == "changed"


@pytest.mark.parametrize("cls", [Odometry, m.Transition, m.Actuation])
def test_both_ways_to_columns_give_every_value(tmp_path, cls):
    rng = np.random.default_rng(2)
    alike = {"child_frame_id": "base_link"} if cls is Odometry else {}
    same = [dataclasses.replace(drawn(cls, rng), header=make_header(i, WORLD), **alike)
            for i in range(6)]  # fmt: skip
    odd = dataclasses.replace(same[0], header=make_header(0, "another_frame"))
    for name, messages in (("fast", same), ("slow", [*same, odd])):
        columns = recorded(tmp_path / f"{name}.mcap", cls, map(encode, messages)).columns(cls)
        for name in {leaf.name for leaf in flat_leaves(cls)[3:]} - {"child_frame_id"}:
            values = map(attrgetter(name), messages)
            told = [list(v) if isinstance(v, tuple) else v for v in values]
            assert columns[name].tolist() == told


GOOD = encode(m.Transition(make_header(0, WORLD), 1, 2, "", ""))
BAD_TAILS = (b"\2\0\0\0ab", b"\2\0\0\0\xff\0", b"\xff\0\0\0", b"", bytes(64))


@pytest.mark.parametrize(
    "bad", [*(GOOD[:24] + tail for tail in BAD_TAILS), b"\0\0" + GOOD[2:], GOOD[:4], b""]
)
def test_a_bad_text_at_the_end_and_big_endian_bytes_are_bad_messages(tmp_path, bad):
    session = recorded(tmp_path / "a.mcap", m.Transition, [GOOD, bad])
    assert refusal(session.columns, m.Transition)[0] == "bad_message"


# Session files are the mcap library's, byte by byte.
def test_bytes_are_the_librarys():
    rng = np.random.default_rng(1)
    theirs, ours = io.BytesIO(), io.BytesIO()
    library, writer = Writer(theirs, enable_data_crcs=True), ContainerWriter(ours, "ros2")
    library.start("ros2", "steerd")
    for name, values in (("one", {"a": "b", "c": ""}), ("two", {})):
        library.add_metadata(name, values)
        writer.add_metadata(name, values)
    for each in (library, writer):
        each.add_attachment(3, 4, "car.toml", "application/toml", b"mass")
    for k in range(3):
        schema = library.register_schema(f"s{k}", "ros2msg", bytes(k))
        assert writer.register_schema(f"s{k}", "ros2msg", bytes(k)) == schema
        channel = library.register_channel(f"/t{k}", "cdr", schema, {"k": "v"})
        assert writer.register_channel(f"/t{k}", "cdr", schema, {"k": "v"}) == channel
    log_ns = 1000
    for k in range(20_000):  # three chunks by their size, more by their flushes
        log_ns += int(rng.integers(-50, 1000))
        message = int(rng.integers(1, 4)), log_ns, rng.bytes(100), log_ns + 1, k
        library.add_message(*message)
        writer.add_message(*message)
        if k % 3001 == 0:
            library.flush()
            writer.flush()
    assert len(library._Writer__chunk_indices) == 7
    assert len(writer._Writer__chunk_indices) == 0  # packed: memory stays flat
    library.finish()
    writer.finish()
    assert ours.getvalue() == theirs.getvalue()
