"""Pipes and sockets between the processes of a run, closed at the end of a test."""

import contextlib
import os
import socket
from collections.abc import Iterator

import pytest

from steerd.daemon.ipc.pipe_records import make_pipe


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """A pipe of a run: its end to read and its end to write; a test may close either."""
    fds = make_pipe()
    yield fds
    for fd in fds:
        with contextlib.suppress(OSError):
            os.close(fd)


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Both ends of a socket for packets, neither of which blocks."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in pair:
        end.setblocking(False)
    yield pair
    for end in pair:
        end.close()
