"""A process that is started before its job is known, and loads what it needs in the meantime.

Only the standard library is imported here: whoever prepares a process has not loaded much either.
"""

# Why: docs/decisions/processes-and-time.md#d110

import contextlib
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

CORE = "steerd.daemon.process.core_process"
"""Module of the control core, which takes longest to load."""
_MOST_FDS = 32
_READ_BYTES = 65536


@dataclass(frozen=True)
class Prepared:
    """A process that waits for its job on standard input.

    Attributes:
        process: it.
        end: our end of the socket on which the job is handed over.
    """

    process: "subprocess.Popen[bytes]"
    end: socket.socket


class Job(NamedTuple):
    """What a prepared process is given.

    Attributes:
        fds: descriptors of the process by name.
        about: what it is to do.
    """

    fds: dict[str, int]
    about: dict[str, Any]


def prepare(module: str) -> Prepared:
    """Start `python -m module` in a process group of its own: Ctrl-C is for the terminal."""
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=theirs.fileno(),
            process_group=0,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
    return Prepared(process, ours)


@contextlib.contextmanager
def prepared(module: str) -> Iterator[Prepared]:
    """A prepared process, killed at the end if nobody gave it a job: it has not done anything."""
    waiting = prepare(module)
    try:
        yield waiting
    finally:
        if waiting.end.fileno() >= 0:
            waiting.end.close()
            waiting.process.kill()
            waiting.process.wait()


def hand_over(waiting: Prepared, fds: Mapping[str, int], about: Mapping[str, Any]) -> None:
    """Give a prepared process its job; one that has ended is noticed by its ready descriptor."""
    with waiting.end, contextlib.suppress(BrokenPipeError, ConnectionResetError):
        socket.send_fds(waiting.end, [json.dumps([*fds]).encode() + b"\n"], [*fds.values()])
        waiting.end.sendall(json.dumps(about).encode())


def receive_job() -> Job | None:
    """In the prepared process: its job; None where the other end was closed without one."""
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as end:
        data, numbers, _, _ = socket.recv_fds(end, _READ_BYTES, _MOST_FDS)
        while more := end.recv(_READ_BYTES):
            data += more
    if not data:
        return None
    names, _, about = data.partition(b"\n")
    return Job(dict(zip(json.loads(names), numbers, strict=True)), json.loads(about))
