"""A disk that fills up at any byte: one error, the same for every later call, nothing else lost."""

import contextlib
import os
import signal
import stat
import subprocess
import sys
import warnings
from unittest.mock import Mock

import pytest

from steerd.steer_bus import atomic_file
from steerd.steer_bus.atomic_file import write_atomically
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import WORLD, ClockSample, make_header
from steerd.steer_bus.session import SessionWriter, recover
from steerd.steer_bus.session_read import SessionError, open_session

MESSAGES = 12
FLUSH_EVERY = 3
FULL = "File too large"


def write_clock(path):
    """A short session; gives how many messages were flushed before the disk was full."""
    attached = {"car.toml": b"mass = 3.1\n"}
    writer = SessionWriter(path, {"/clock": ClockSample}, {"steerd.session": {}}, attached)
    flushed = 0
    for i in range(1, MESSAGES + 1):
        message = ClockSample(make_header(i, WORLD), i, i, i)
        with contextlib.suppress(SessionError):
            writer.write("/clock", encode(message), i)
            if i % FLUSH_EVERY == 0:
                writer.flush()
                flushed = i
    return writer, flushed


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Size of the session on a disk with room, before its end and in all [bytes]."""
    writer, _ = write_clock(tmp_path_factory.mktemp("whole") / "a.mcap")
    body = writer.partial.stat().st_size
    return body, writer.finish({"reason": "end"}).stat().st_size


def fill(path):
    """Write until the disk is full; the error, and the messages flushed before."""
    try:
        writer, flushed = write_clock(path)
    except SessionError as error:
        assert not path.with_name("a.mcap.partial").exists(), "it held no message"
        return error, None
    with pytest.raises(SessionError) as caught:
        writer.finish({"reason": "end"})
    for call in (writer.flush, writer.sync, lambda: writer.write("/clock", b"", 1)):
        with pytest.raises(SessionError, match=FULL):
            call()
    writer.abandon()
    return caught.value, flushed


@pytest.mark.slow
def test_whatever_byte_is_the_last_one(tmp_path, room_for, whole):
    body, size = whole
    saved = set()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for room in range(size):
            path = tmp_path / str(room) / "a.mcap"
            path.parent.mkdir()
            room_for(room)
            error, flushed = fill(path)
            room_for()
            assert error.code == "disk"
            assert FULL in str(error)
            assert not path.exists()
            if not flushed:
                continue
            found = open_session(path.with_name("a.mcap.partial"))
            assert found.info().count >= flushed
            assert found.attachment("car.toml") == b"mass = 3.1\n"
            saved.add(found.info().count)
            if room in (body, size - 1) or room % 97 == 0:
                recover(found, path)
                assert open_session(path).info().count == found.info().count
    assert saved == set(range(FLUSH_EVERY, MESSAGES + 1, FLUSH_EVERY))


# A file is replaced whole or not at all.
def test_a_file_is_made_and_replaced(tmp_path):
    path = tmp_path / "car.toml"
    write_atomically(path, "mass = 3.5 # kg, ±0.1\n")
    assert path.read_text(encoding="utf-8") == "mass = 3.5 # kg, ±0.1\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    write_atomically(path, b"\x00\xff", mode=0o600)
    assert (path.read_bytes(), stat.S_IMODE(path.stat().st_mode)) == (b"\x00\xff", 0o600)
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_keeps_the_old_file_and_leaves_nothing(tmp_path, monkeypatch):
    path = tmp_path / "car.toml"
    path.write_text("old")
    full = Mock(side_effect=OSError(28, "No space left on device"))
    monkeypatch.setattr(atomic_file.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, "new")
    assert (path.read_text(), list(tmp_path.iterdir())) == ("old", [path])


# A writer that is killed loses at most the last quarter of a second.
WRITER = """
import sys
from pathlib import Path
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import ClockSample, make_header
from steerd.steer_bus.session import SessionWriter

clock = MonotonicClock()
writer = SessionWriter(Path(sys.argv[1]), {"/clock": ClockSample}, {"steerd.session": {}})
start = due = clock.now_ns()
while True:
    due += 1_000_000
    clock.sleep_until_ns(due)
    now = clock.now_ns()
    message = ClockSample(make_header(now, "map"), now, now, 0)
    writer.write("/clock", encode(message), now)
    writer.tick(now)
    sys.stdout.buffer.write(now.to_bytes(8, "little"))
    sys.stdout.buffer.flush()
"""


@pytest.mark.realtime
@pytest.mark.parametrize("progress_ns", [700_000_000, 1_120_000_000])
def test_sigkill_loses_at_most_three_tenths_of_a_second(tmp_path, progress_ns):
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        first = last = int.from_bytes(process.stdout.read(8), "little")
        while last - first < progress_ns:
            last = int.from_bytes(process.stdout.read(8), "little")
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read()
        process.wait()
    last = int.from_bytes(rest[-8:], "little") if rest else last
    session = open_session(path.with_name("a.mcap.partial"))
    assert session.info().warnings[-1].startswith("not finished")
    assert "steerd.session" in session.info().metadata
    times = session.columns(ClockSample)["monotonic_ns"]
    assert last - times[-1] <= 300_000_000
    recover(session, path)
    assert open_session(path).info().count == len(times)
