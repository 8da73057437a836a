"""The serial port: opened and configured by pyserial, read and written on its file descriptor.

pyserial's ``write`` spins for ever once the transmit buffer is full
(`docs/reference/safety-requirements.md#s7.2`), so nothing here calls it: bytes go through
``os.read`` and ``os.write`` on a non-blocking descriptor, and a write that cannot be done whole and
at once is a fault of the link.
"""

import contextlib
import errno
import fcntl
import os
import struct
import termios
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import platformdirs
import serial  # noqa: TID251

from steerd.vesc_link.frames import FLUSH

READ_LIMIT = 4096
"""Most bytes one `Port.read` returns; the rest waits for the next tick."""
_UDEV_HINT = (
    "install the udev rule and replug:\n"
    "  steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules"
)


class PortError(OSError):
    """A serial port that cannot be used; ``hint`` says what to try next."""

    hint = ""

    def __init__(self, url: str, what: str) -> None:
        super().__init__(f"{url}: {what}")
        self.url = url


class NotFound(PortError):  # noqa: N818
    """No such port, or not one that a VESC can be on."""

    hint = (
        "is the VESC powered and its USB cable in? `ls -l /dev/ttyACM* /dev/serial/by-id` shows the"
        f" ports there are; for a stable name, {_UDEV_HINT}"
    )


class PermissionDenied(PortError):  # noqa: N818
    """The user may not open the port."""

    hint = f"`sudo usermod -aG dialout $USER`, then log out and in again; or {_UDEV_HINT}"


class Busy(PortError):  # noqa: N818
    """Another program holds the port."""

    hint = (
        "close VESC Tool, another steerd or a ROS driver on this port (`fuser -v PORT` names it); "
        f"if ModemManager probes it, {_UDEV_HINT}"
    )


class LinkDown(PortError):  # noqa: N818
    """The port was open and does not take or give bytes any more."""

    hint = "check the USB cable and the VESC's power; the motor's state is unknown"


_ON_OPEN: dict[int, type[PortError]] = {
    **dict.fromkeys((errno.EACCES, errno.EPERM), PermissionDenied),
    **dict.fromkeys((errno.EBUSY, errno.EAGAIN), Busy),
    **dict.fromkeys((errno.EIO, errno.ENODEV, errno.ENXIO), LinkDown),
}


class Port:
    """An open serial port. Made by `open_port`.

    Attributes:
        fd: non-blocking file descriptor, for ``poll`` and for a guardian's duplicate.
        url: what the port was opened as.
    """

    def __init__(self, url: str, device: serial.Serial, lock_fd: int | None) -> None:
        self.url = url
        self.fd: int = device.fileno()
        self._device: serial.Serial | None = device
        self._lock_fd = lock_fd
        self._spy: Any = getattr(device, "formatter", None)

    def read(self, limit: int = READ_LIMIT) -> bytes:
        """What has arrived, up to ``limit`` bytes; empty when nothing has.

        A device may give less than has arrived; then its descriptor is still readable.

        Raises:
            LinkDown: the other end is gone.
        """
        # One call, for a second one costs a tick more than the bytes do: what it leaves behind
        # keeps the descriptor readable.
        try:
            data = os.read(self.fd, limit)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkDown(self.url, f"read failed: {error.strerror}") from error
        if not data:
            raise LinkDown(self.url, "hung up")
        if self._spy is not None:
            self._spy.rx(data)
        return data

    def write(self, data: bytes | memoryview) -> None:
        """Hand all bytes to the kernel at once, without a copy in between.

        Raises:
            LinkDown: not all of them were taken, or the device is gone.
        """
        try:
            count = os.write(self.fd, data)
        except BlockingIOError as error:
            raise LinkDown(self.url, "transmit buffer full, nothing sent") from error
        except OSError as error:
            raise LinkDown(self.url, f"write failed: {error.strerror}") from error
        if self._spy is not None:
            self._spy.tx(bytes(data[:count]))
        if count != len(data):
            raise LinkDown(self.url, f"short write: {count} of {len(data)} bytes")

    def out_queue(self) -> int:
        """Bytes the kernel has not sent yet; a growing number means the device does not read.

        Raises:
            LinkDown: the device is gone.
        """
        try:
            raw = fcntl.ioctl(self.fd, termios.TIOCOUTQ, b"\0\0\0\0")
        except (OSError, ValueError) as error:
            raise LinkDown(self.url, f"status failed: {error}") from error
        return int(struct.unpack("i", raw)[0])

    def close(self) -> None:
        """Close the port and give up its locks; closing again does nothing."""
        if self._device is None:
            return
        device, self._device, self.fd = self._device, None, -1
        # On a pty the flag outlives this end, and would lock out the next one.
        with contextlib.suppress(OSError):
            fcntl.ioctl(device.fileno(), termios.TIOCNXCL)
        device.close()
        if self._spy is not None and self._spy.output.fileno() > 2:
            self._spy.output.close()
        if self._lock_fd is not None:
            os.close(self._lock_fd)
            self._lock_fd = None


def open_port(url: str, lock_dir: Path | None = None) -> Port:
    """Open a serial device for this process alone.

    Three locks, because each stops a different neighbour: ``flock`` on the device (pyserial's
    ``exclusive``), TIOCEXCL (programs that lock nothing) and a lock file (another steerd started
    through another name of the same device). 520 zeros are written first, which free the VESC's
    parser from a frame that a dead predecessor left half sent
    (`docs/reference/vesc-serial.md#v1.7`).

    Args:
        url: a device path, or ``spy:///dev/ttyACM0?file=trace.txt`` to log all traffic.
        lock_dir: where lock files live; default a folder of the user's own.

    Raises:
        NotFound: there is no such device, or it is no serial port.
        PermissionDenied: the user may not use it.
        Busy: someone else has it open.
        LinkDown: it went away while it was opened.
    """
    lock_fd = _take_lock(url, _device_path(url), lock_dir or _own_locks())
    device = None
    try:
        device = _open_device(url)
        port = Port(url, device, lock_fd)
        _configure(port)
        port.write(FLUSH)
    except BaseException:
        if device is not None:
            device.close()
        if lock_fd is not None:
            os.close(lock_fd)
        raise
    return port


def _device_path(url: str) -> Path:
    if "://" not in url:
        return Path(url)
    parts = urlsplit(url)
    if parts.scheme != "spy":
        raise NotFound(url, f"{parts.scheme}:// has no file descriptor to drive a car through")
    return Path(parts.netloc + parts.path)


def _own_locks() -> Path:
    """Where nobody else can put a link or a file of the lock's name."""
    folder = platformdirs.user_cache_path("steerd") / "locks"
    with contextlib.suppress(OSError):
        for each in (*reversed(folder.parents), folder):
            each.mkdir(0o700, exist_ok=True)
        folder.chmod(0o700)
    return folder


def _take_lock(url: str, device: Path, lock_dir: Path) -> int | None:
    """Lock a file named after the real device; None where no such file can be made."""
    name = str(device.resolve()).strip("/").replace("/", "_")
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        fd = os.open(lock_dir / f"steerd-{name}.lock", flags, 0o600)
    except OSError:
        return None  # no such folder, or a link lies there: the device's own locks remain
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(fd)
        raise Busy(url, "another steerd holds it") from error
    return fd


def _open_device(url: str) -> serial.Serial:
    try:
        return serial.serial_for_url(url, exclusive=True, timeout=0, write_timeout=0)
    except serial.SerialException as error:
        number = error.errno if error.errno is not None else _cause(error)
        make = _ON_OPEN.get(number, NotFound)
        raise make(url, os.strerror(number) if number else "no serial port") from error


def _cause(error: serial.SerialException) -> int:
    """Pyserial keeps the number of a failed configuration only in the exception's context."""
    args = error.__context__.args if error.__context__ is not None else ()
    return args[0] if args and isinstance(args[0], int) else 0


def _configure(port: Port) -> None:
    """Non-blocking, exclusive, and reads that distinguish an empty port from a closed one."""
    os.set_blocking(port.fd, False)
    with contextlib.suppress(OSError):
        fcntl.ioctl(port.fd, termios.TIOCEXCL)
    try:
        settings = termios.tcgetattr(port.fd)
        # With VMIN 0, as pyserial sets it, both an empty and a hung-up port read as b"".
        settings[6][termios.VMIN] = 1
        termios.tcsetattr(port.fd, termios.TCSANOW, settings)
    except termios.error as error:
        raise LinkDown(port.url, f"configuration failed: {error}") from error
