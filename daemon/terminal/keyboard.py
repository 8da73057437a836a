"""Single keys from standard input."""

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator

from steerd.steer_bus.clock import Clock


@contextlib.contextmanager
def keys_one_by_one() -> Iterator[int | None]:
    """Standard input as single keys, if it is a terminal."""
    if not sys.stdin.isatty():
        yield None
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    try:
        yield fd
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def wait_for_key(keys: int | None, most_ns: int, clock: Clock) -> str:
    """The keys pressed within this time, up to the first; none where there is no keyboard."""
    if keys is None:
        clock.sleep_until_ns(clock.now_ns() + most_ns)
        return ""
    ready, _, _ = select.select([keys], [], [], most_ns * 1e-9)
    return os.read(keys, 1).decode("latin-1") if ready else ""
