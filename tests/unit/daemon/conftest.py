"""Pipes and sockets between the processes of a run, closed at the end of a test."""

import contextlib
import os
import socket

import pytest

from steerd.daemon.ipc.pipe_records import make_pipe


@pytest.fixture
def pipe():
    """A pipe of a run: its end to read and its end to write; a test may close either."""
    fds = make_pipe()
    yield fds
    for fd in fds:
        with contextlib.suppress(OSError):
            os.close(fd)


@pytest.fixture
def make_ends():
    """Makes both ends of a socket for packets, neither of which blocks."""
    with contextlib.ExitStack() as open_ends:

        def make():
            pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            for end in pair:
                open_ends.enter_context(end).setblocking(False)
            return pair

        yield make


ends = pytest.fixture(lambda make_ends: make_ends())
