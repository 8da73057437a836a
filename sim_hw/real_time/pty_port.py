"""The simulated serial port: a pty under a stable name, which goes away as USB devices do."""

import contextlib
import os
import select
import tty
from pathlib import Path

from steerd.sim_hw.world import World

_READ = 4096
_GRACE_NS = 100_000_000
"""How long a program that closed the port has to open it again before it is made anew."""


class PtyPort:
    """The VESC's end of a pty, linked as ``vesc`` (or the name the world gives) in a directory.

    A program that was killed leaves its exclusive lock and unread bytes behind in a pty, which a
    USB port would not; so once nobody has the port open any more it is replaced by a fresh one.
    """

    def __init__(self, directory: Path) -> None:
        self._dir = directory
        self._name: str | None = None
        self._near = -1
        self._pending = b""
        self._used = self._hung = False
        self._hung_ns = 0

    def read_fds(self) -> tuple[int, ...]:
        """What to poll; a port that nobody has open would report so all the time."""
        return (self._near,) if self._near >= 0 and not self._hung else ()

    def follow(self, world: World, t_ns: int) -> None:
        """Appear, vanish or change names as the world's device does."""
        world.advance(t_ns)
        if world.serial_name == self._name:
            return
        self.close()
        if world.serial_name is not None:
            self._open(world.serial_name)

    def _open(self, name: str) -> None:
        self._near, far = os.openpty()
        tty.setraw(far)
        os.set_blocking(self._near, False)
        temporary = self._dir / f".{name}.new"
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(os.ttyname(far))
        temporary.replace(self._dir / name)
        os.close(far)
        self._name = name
        self._used, self._hung = False, True

    def close(self) -> None:
        """Unplug: programs that have it open get EIO, the name is gone."""
        if self._name is None:
            return
        (self._dir / self._name).unlink(missing_ok=True)
        os.close(self._near)
        self._near, self._name, self._pending = -1, None, b""

    def pump(self, world: World, t_ns: int) -> None:
        """Move bytes both ways."""
        if self._near < 0:
            return
        if not world.vesc.fault_state.stalled:
            data = self._read()
            if data:
                world.serial_write(t_ns, data)
        if self._watch_users(t_ns) and world.serial_name == self._name:
            self._write(world, t_ns)

    def _read(self) -> bytes:
        try:
            return os.read(self._near, _READ)
        except OSError:  # nothing there, or nobody has it open
            return b""

    def _watch_users(self, t_ns: int) -> bool:
        """Whether somebody has the port open; makes it anew after the last has left."""
        poll = select.poll()
        poll.register(self._near, 0)
        hung = bool(poll.poll(0))
        if hung and not self._hung:
            self._hung_ns = t_ns
        self._hung = hung
        self._used |= not hung
        if hung and self._used and t_ns - self._hung_ns > _GRACE_NS and self._name is not None:
            os.close(self._near)
            self._pending = b""
            self._open(self._name)
        return not hung

    def _write(self, world: World, t_ns: int) -> None:
        """Hand over what the host's buffer takes; the world hears of a host that does not read."""
        if not self._pending:
            self._pending = world.serial_read(t_ns)
        if self._pending:
            with contextlib.suppress(BlockingIOError):
                count = os.write(self._near, self._pending)
                self._pending = self._pending[count:]
