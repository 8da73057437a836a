"""A process of a run: it gets descriptors by name and a job, and says when it is ready.

It may be started before its job is known, and loads what it needs in the meantime. Little more than
the standard library is imported here: whoever prepares a process has not loaded much either.
"""

# Why: docs/decisions/processes-and-time.md#d110

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.signals import ignore_terminal_signals

CORE = "steerd.daemon.process.core_process"  # the control core, which takes longest to load
READY_S = 30.0  # longest time until a process is ready [s]
_MOST_FDS = 32
_READ_BYTES = 65536


class Child:
    """A process of a run: it waits for its job on standard input, and reports once it is ready.

    It runs `module` in a process group of its own, since Ctrl-C is for the terminal. `ready_fd` is
    where it reports; -1 before it has its job.
    """

    def __init__(self, module: str) -> None:
        self.ready_fd = -1
        self.end, theirs = socket.socketpair()  # the job is handed over on it
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module],
                stdin=theirs.fileno(),
                process_group=0,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )

    def hand_over(self, fds: Mapping[str, int], about: Mapping[str, Any]) -> "Child":
        """Give it its job; that it has ended is noticed by its ready descriptor."""
        self.ready_fd, child_fd = os.pipe()
        every = {**fds, "ready": child_fd}
        with self.end, contextlib.suppress(BrokenPipeError, ConnectionResetError):
            socket.send_fds(self.end, [json.dumps([*every]).encode() + b"\n"], [*every.values()])
            self.end.sendall(json.dumps(about).encode())
        os.close(child_fd)
        return self

    def close(self) -> None:
        """Kill it if nobody gave it a job: it has not done anything."""
        if self.ready_fd < 0:
            self.end.close()
            self.process.kill()
            self.process.wait()

    def wait_ready(self, name: str) -> dict[str, Any]:
        """What it reports once it is ready.

        Raises:
            SteerdError: it cannot be, with its own text; it ended, or nothing came in time.
        """
        poll = select.poll()
        poll.register(self.ready_fd, select.POLLIN | select.POLLHUP)
        line = b""
        while not line.endswith(b"\n"):
            if not poll.poll(int(READY_S * 1000)):
                raise SteerdError(f"the {name} did not start", "", ExitCode.INTERNAL)
            data = os.read(self.ready_fd, 4096)
            if not data:
                code = self.process.wait()
                raise SteerdError(f"the {name} ended with code {code}", "", ExitCode.INTERNAL)
            line += data
        report: dict[str, Any] = json.loads(line)
        if "what" in report:
            raise SteerdError(report["what"], report["hint"], ExitCode(report["code"]))
        return report


class Job(NamedTuple):
    """What a process is given."""

    fds: dict[str, int]  # its descriptors by name; `ready` takes its report
    about: dict[str, Any]  # what it is to do

    def say_ready(self, **report: object) -> None:
        """Report once that it is ready; nobody may be there to read it."""
        ready_fd = self.fds.pop("ready")
        with contextlib.suppress(BrokenPipeError):  # Ctrl-C ended the terminal
            os.write(ready_fd, json.dumps(report).encode() + b"\n")
        os.close(ready_fd)

    def refuse(self, error: SteerdError) -> int:
        """Say what it cannot do: to the parent, or in words once it was ready; its exit code."""
        if "ready" in self.fds:
            self.say_ready(what=error.what, hint=error.hint, code=int(error.code))
        else:
            print(f"steerd {Path(sys.argv[0]).stem}: {error.what}", file=sys.stderr)
        return int(error.code)


def receive_job() -> Job | None:
    """In the process: its job; None where the other end was closed without one."""
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as end:
        data, numbers, _, _ = socket.recv_fds(end, _READ_BYTES, _MOST_FDS)
        while more := end.recv(_READ_BYTES):
            data += more
    if not data:
        return None
    names, _, about = data.partition(b"\n")
    return Job(dict(zip(json.loads(names), numbers, strict=True)), json.loads(about))


def run_process(
    serve: Callable[[Job], int], nice: int = 0, begin: Callable[[], None] = ignore_terminal_signals
) -> NoReturn:
    """The whole of a process: what it begins with, its job (`serve`), its exit code.

    Its priority is lower than the control processes' by `nice`. Most end when the core's pipe
    closes, not by signals. What `serve` cannot do it says by SteerdError, which the parent gets.
    """
    begin()
    os.nice(nice)
    code = 0
    if (given := receive_job()) is not None:
        try:
            code = serve(given)
        except SteerdError as error:
            code = given.refuse(error)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # threads of a library may keep the interpreter alive; nothing is left to do
