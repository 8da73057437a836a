"""A disk that fills up at any byte: one error, the same for every later call, nothing else lost."""

import contextlib
import errno
import io
import warnings

import pytest

from steerd.steer_bus import session
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import WORLD, ClockSample, make_header
from steerd.steer_bus.session import (
    AttachedFile,
    SessionError,
    SessionWriter,
    open_session,
    recover,
)

MESSAGES = 12
FLUSH_EVERY = 3


class FillingDisk(io.FileIO):
    """A file that takes so many bytes and no more."""

    def __init__(self, path, room):
        super().__init__(path, "xb")
        self.room = room

    def write(self, data):
        taken = min(len(data), self.room)
        if not taken:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.room -= taken
        return super().write(bytes(data[:taken]))


def write_clock(path):
    """A short session; gives how many messages were flushed before the disk was full."""
    attached = [AttachedFile("car.toml", "application/toml", b"mass = 3.1\n")]
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


@pytest.fixture
def disk(monkeypatch):
    """Give the next session's file so many bytes of room."""

    def limit(room):
        monkeypatch.setattr(
            session, "_create", lambda path, partial: io.BufferedWriter(FillingDisk(partial, room))
        )

    return limit


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
        with pytest.raises(SessionError, match="No space left"):
            call()
    writer.abandon()
    return caught.value, flushed


@pytest.mark.slow
def test_whatever_byte_is_the_last_one(tmp_path, disk, whole):
    body, size = whole
    saved = set()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for room in range(size):
            path = tmp_path / str(room) / "a.mcap"
            path.parent.mkdir()
            disk(room)
            error, flushed = fill(path)
            assert error.code == "disk"
            assert "No space left on device" in str(error)
            assert not path.exists()
            if not flushed:
                continue
            partial = path.with_name("a.mcap.partial")
            found = open_session(partial)
            assert found.info().count >= flushed
            assert found.attachment("car.toml") == b"mass = 3.1\n"
            saved.add(found.info().count)
            if room in (body, size - 1) or room % 97 == 0:
                with pytest.MonkeyPatch.context() as undone:
                    undone.setattr(session, "_create", lambda path, partial: partial.open("xb"))
                    assert recover(partial, path).messages == found.info().count
    assert saved == set(range(FLUSH_EVERY, MESSAGES + 1, FLUSH_EVERY))


def test_a_recovery_without_room_leaves_nothing_behind(tmp_path, disk):
    writer, _ = write_clock(tmp_path / "a.mcap")
    writer.abandon()
    disk(300)
    with pytest.raises(SessionError, match="No space left") as caught:
        recover(writer.partial, tmp_path / "b.mcap")
    assert caught.value.hint == "free some space, or choose another folder"
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.partial"]
