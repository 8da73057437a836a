"""The port against a real tty: a pty, whose other end plays the VESC."""

import errno
import os
import pty
import select
import tty
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from steerd.vesc_link import transport
from steerd.vesc_link.frames import FLUSH, FrameParser, encode_frame

FRAME = encode_frame(b"\x08\x00\x00\x12\x06")


class Device:
    """The VESC's end of a pty."""

    def __init__(self) -> None:
        self.fd, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self.fd, False)
        self.path = os.ttyname(slave)
        self._slave = slave

    def release(self) -> None:
        """Let go of the car's end, so that only the port holds it."""
        if self._slave >= 0:
            os.close(self._slave)
            self._slave = -1

    def unplug(self) -> None:
        self.release()
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def read(self, count: int) -> bytes:
        got = b""
        while len(got) < count and select.select([self.fd], [], [], 2.0)[0]:
            got += os.read(self.fd, count - len(got))
        return got


@pytest.fixture
def device() -> Iterator[Device]:
    made = Device()
    yield made
    made.unplug()


@pytest.fixture
def reopen(device: Device, tmp_path: Path) -> Callable[..., transport.Port]:
    """Open the device, its lock file in a folder of the test's own."""
    return partial(transport.open_port, device.path, lock_dir=tmp_path)


@pytest.fixture
def port(device: Device, reopen: Callable[..., transport.Port]) -> Iterator[transport.Port]:
    opened = reopen()
    assert device.read(len(FLUSH)) == FLUSH
    device.release()
    yield opened
    opened.close()


def wait_readable(port: transport.Port) -> None:
    assert select.select([port.fd], [], [], 2.0)[0], "nothing to read within two seconds"


def read_exactly(port: transport.Port, count: int) -> bytes:
    got = b""
    while len(got) < count:
        wait_readable(port)
        got += port.read()
    return got


def test_open_writes_the_zero_flush_which_frees_a_blocked_parser(device, reopen):
    firmware = FrameParser(strict=True)
    assert firmware.feed(b"\x03\x02\x00", 0) == []
    with closing(reopen()) as port:
        port.write(FRAME)
        assert firmware.feed(device.read(len(FLUSH) + len(FRAME)), 1) == [FRAME[2:-3]]


def test_bytes_pass_unchanged_both_ways(device, port):
    everything = bytes(range(256))
    port.write(everything)
    assert device.read(256) == everything
    os.write(device.fd, everything)
    assert read_exactly(port, 256) == everything


def test_read_drains_is_bounded_and_of_an_idle_port_returns_at_once(port, device):
    assert port.read() == b""
    assert not os.get_blocking(port.fd)
    os.write(device.fd, bytes(600))
    wait_readable(port)
    assert port.read(limit=500) == bytes(500)
    assert read_exactly(port, 100) == bytes(100)
    assert port.read() == b""


def test_unread_device_fills_the_buffer_and_write_says_so_each_time(port):
    def write_on() -> None:
        for _ in range(100_000):
            port.write(FRAME)

    for _ in range(2):  # the kernel may move a little on meanwhile: full again, not full for ever
        with pytest.raises(transport.LinkDown, match=r"full|short write"):
            write_on()


def test_out_queue_of_an_idle_port_is_empty_and_of_a_closed_one_a_fault(port):
    assert port.out_queue() == 0
    port.close()
    for use in (port.out_queue, lambda: port.write(FRAME), port.read):
        with pytest.raises(transport.LinkDown):
            use()


def test_bytes_before_a_failure_are_still_delivered(port, monkeypatch):
    numbers = [errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF]
    answers: list[bytes | int] = [each for number in numbers for each in (FRAME, number)]
    answers += [FRAME, b""]

    def scripted(*_: object) -> bytes:
        answer = answers.pop(0)
        if isinstance(answer, int):
            raise OSError(answer, os.strerror(answer))
        return answer

    monkeypatch.setattr(os, "read", scripted)
    for reason in (*(f"read failed: {os.strerror(number)}" for number in numbers), "hung up"):
        assert port.read() == FRAME
        with pytest.raises(transport.LinkDown, match=reason):
            port.read()
    assert answers == []


def test_unplug_is_seen_by_read_and_write(device, port):
    device.unplug()
    with pytest.raises(transport.LinkDown) as read_error:
        port.read()
    with pytest.raises(transport.LinkDown, match="write failed"):
        port.write(FRAME)
    assert "cable" in read_error.value.hint


def test_second_open_is_refused_by_another_name_too_and_names_the_holder(device, port, tmp_path):
    with pytest.raises(transport.Busy) as error:
        transport.open_port(device.path, lock_dir=tmp_path)
    assert "VESC Tool" in error.value.hint
    other = tmp_path / "other"
    other.mkdir()
    with pytest.raises(transport.Busy):  # the device's own lock, where no lock file shows it
        transport.open_port(device.path, lock_dir=other)
    link = tmp_path / "vesc"
    link.symlink_to(device.path)
    with pytest.raises(transport.Busy, match="another steerd"):
        transport.open_port(str(link), lock_dir=tmp_path)


def test_a_link_in_the_locks_place_is_not_followed(device, tmp_path):
    """A lock opened through it would make a file of somebody else's choice, or change it."""
    name = str(Path(device.path).resolve()).strip("/").replace("/", "_")
    target = tmp_path / "target"
    (tmp_path / f"steerd-{name}.lock").symlink_to(target)
    port = transport.open_port(device.path, lock_dir=tmp_path)
    assert not target.exists()
    with pytest.raises(transport.Busy):  # the device's own locks hold
        transport.open_port(device.path, lock_dir=tmp_path / "other")
    port.close()


@pytest.mark.parametrize("there", [False, True])
def test_locks_lie_in_a_folder_of_the_users_own(there, device, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    mask = os.umask(0)
    folder = tmp_path / "steerd" / "locks"
    if there:  # and open to everybody
        folder.mkdir(parents=True)
    port = transport.open_port(device.path)
    os.umask(mask)
    (lock,) = folder.iterdir()
    assert [p.stat().st_mode & 0o777 for p in (lock, folder)] == [0o600, 0o700]
    assert there or folder.parent.stat().st_mode & 0o777 == 0o700
    port.close()


def test_close_frees_everything_and_can_be_repeated(reopen):
    for _ in range(3):
        port = reopen()
        port.close()
        port.close()
        assert port.fd == -1


def test_failed_open_frees_the_lock(device, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(transport, "FLUSH", bytes(1 << 20))
        with pytest.raises(transport.LinkDown, match=r"short write: \d+ of 1048576 bytes") as error:
            transport.open_port(device.path, lock_dir=tmp_path)
    device.read(int(str(error.value).split("short write: ")[1].split()[0]))
    transport.open_port(device.path, lock_dir=tmp_path).close()


def test_no_such_port_or_one_without_a_descriptor(tmp_path):
    with pytest.raises(transport.NotFound) as error:
        transport.open_port(str(tmp_path / "ttyACM9"), lock_dir=tmp_path)
    assert "steerd service udev" in error.value.hint
    assert isinstance(error.value, transport.PortError)
    assert isinstance(error.value, OSError)
    for url in ("socket://127.0.0.1:5000", "loop://", "rfc2217://host:1"):
        with pytest.raises(transport.NotFound, match="no file descriptor"):
            transport.open_port(url, lock_dir=tmp_path)


@pytest.mark.parametrize(("number", "kind", "hint"), [
    (errno.EACCES, transport.PermissionDenied, "dialout"), (errno.EBUSY, transport.Busy, "fuser"),
    (errno.EIO, transport.LinkDown, "cable"), (errno.ENOENT, transport.NotFound, "powered"),
])  # fmt: skip
def test_errors_of_open_become_types_with_a_hint(tmp_path, monkeypatch, number, kind, hint):
    def refuse(*_: object, **__: object) -> None:
        raise transport.serial.SerialException(number, "no")

    monkeypatch.setattr(transport.serial, "serial_for_url", refuse)
    with pytest.raises(kind) as error:
        transport.open_port("/dev/ttyACM7", lock_dir=tmp_path)
    assert hint in error.value.hint
    assert os.strerror(number) in str(error.value)


def test_spy_url_logs_what_passes(device, tmp_path):
    log = tmp_path / "trace.txt"
    port = transport.open_port(f"spy://{device.path}?file={log}", lock_dir=tmp_path)
    port.write(FRAME)
    assert device.read(len(FLUSH) + len(FRAME)) == FLUSH + FRAME
    os.write(device.fd, b"\x02")
    assert read_exactly(port, 1) == b"\x02"
    port.close()
    text = log.read_text()
    for said in ("TX", "02 05 08 00 00 12 06 07", "RX"):
        assert said in text
