"""The processes of a run: jobs on standard input, ended by closing their pipes."""

# Why: docs/decisions/safety.md#d16

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steerd.daemon.assembly.build import RunPlan, make_job
from steerd.daemon.assembly.session_meta import make_attachments, make_metadata
from steerd.daemon.common.errors import ExitCode, SteerdError, refusing
from steerd.daemon.ipc.pipe_records import make_pipe
from steerd.daemon.learning.kept import recall_learnt
from steerd.daemon.process.child import CORE, Child
from steerd.daemon.settings.run_options import RunOptions

END_S, VIEWER_END_S = 10.0, 2.0  # longest time until a process has ended, before it is killed [s]
_MODULE = "steerd.daemon.process."


class Ends:
    """Descriptors of a run by process and name; those of `terminal` are this process's own.

    Who ends, or drops them, is noticed by the others.
    """

    def __init__(self, options: RunOptions) -> None:
        self.of: dict[str, dict[str, int]] = defaultdict(dict)
        readers = ["recorder", "gateway"]
        readers += [name for name, on in (("view", options.view), ("learner", options.learn)) if on]
        for reader in readers:
            self._pipe("core", reader, reader, "pipe")
        self._pipe("core", "status", "terminal", "status")
        self._socket("core", "parent", "terminal", "requests")
        self._socket("core", "gateway_requests", "gateway", "requests")
        if options.learn:
            for reader in ("recorder", "gateway", "terminal", *(["view"] if options.view else [])):
                self._pipe("learner", f"to_{reader}", reader, "reports")
        if options.adapt:
            self._socket("core", "designs", "learner", "designs")
        if options.view_sets:
            self._socket("view", "requests", "terminal", "view_requests")
        if options.page is not None:
            self._pipe("terminal", "lifeline", "page", "lifeline")

    def _pipe(self, writer: str, written: str, reader: str, read: str) -> None:
        self.of[reader][read], self.of[writer][written] = make_pipe()

    def _socket(self, one: str, name: str, other: str, other_name: str) -> None:
        ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.of[one][name], self.of[other][other_name] = (end.detach() for end in ends)

    def close(self, *, keep: str = "") -> None:
        """Close all here but those of one process."""
        for process, fds in self.of.items():
            for fd in fds.values() if process != keep else ():
                os.close(fd)


@dataclass
class RunProcesses:
    """All processes of a run: by name, and what each reported when it was ready."""

    children: dict[str, Child]  # core, recorder and gateway; others where they were asked for
    # This terminal's descriptors: `status` gives records, `requests` and `view_requests` are
    # sockets to the core and from the viewer, `reports` gives the learner's; the page ends when
    # `lifeline` closes
    fds: dict[str, int]
    reports: dict[str, dict[str, Any]]

    def __post_init__(self) -> None:
        self.requests = socket.socket(fileno=self.fds["requests"])
        self.requests.setblocking(False)  # a core that is frozen must not freeze its terminal
        asked = self.fds.get("view_requests")
        self.viewer_requests = None if asked is None else socket.socket(fileno=asked)

    @property
    def core(self) -> Child:
        """The control core."""
        return self.children["core"]

    def end(self) -> int:
        """Wait for the core, then for the others, which end when its pipes close.

        The exit code is the core's, or the recorder's where the session is not whole; a process
        that was killed is a safety stop.
        """
        code = self.core.process.wait()
        if code < 0:
            print(f"stopped: signal {-code} ended the control core", file=sys.stderr)
        for end in (self.requests, self.viewer_requests):
            if end is not None:
                end.close()
        recorded, _ = (_end(self.children[name], END_S) for name in ("recorder", "gateway"))
        code = code or recorded
        if "lifeline" in self.fds:
            os.close(self.fds["lifeline"])
        for name in self.children.keys() & {"viewer", "page", "learner"}:
            if lost := _end(self.children[name], VIEWER_END_S):  # the exit code stays the core's
                print(f"note: the {name} ended with code {lost}", file=sys.stderr)
        return ExitCode.STOPPED if code < 0 else code


def _end(child: Child, seconds: float) -> int:
    """Its exit code; one that has not ended in time is killed."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        return child.process.wait(seconds)
    child.process.kill()
    return child.process.wait()


def start_processes(plan: RunPlan, session: Path, core: Child | None = None) -> RunProcesses:
    """Start recorder, gateway, core and, where they are asked for, viewer, page and learner.

    `core` is the control core's process where it was prepared already.

    Raises:
        SteerdError: one of them failed to start, with its own text.
    """
    ends, now_ns = Ends(plan.options), plan.run.epoch_ns + time.monotonic_ns()
    memory = recall_learnt(plan, session, now_ns)
    started: dict[str, Child] = {}
    reports: dict[str, dict[str, Any]] = {}
    try:
        # All at once: each takes a second for its imports. What the core writes before the others
        # are ready waits in its pipes.
        job = make_recorder_job(plan, session, memory.metadata)
        started["recorder"] = Child(f"{_MODULE}recorder").hand_over(ends.of["recorder"], job)
        job = make_job(plan)
        started["core"] = (core or Child(CORE)).hand_over(ends.of["core"], job)
        started["gateway"] = Child(f"{_MODULE}gateway").hand_over(ends.of["gateway"], job)
        if plan.options.view:
            started["viewer"] = Child(f"{_MODULE}view").hand_over(ends.of["view"], job)
        for name, child in started.items():
            reports[name] = child.wait_ready(name)
        if plan.options.page is not None:  # the bus is up
            started["page"] = Child(f"{_MODULE}page").hand_over(ends.of["page"], job)
            reports["page"] = started["page"].wait_ready("page")
    except SteerdError:
        ends.close()
        for child in started.values():
            _end(child, END_S)
        if "recorder" in reports:
            session.unlink(missing_ok=True)
        raise
    if plan.options.learn:  # nobody waits for it
        job |= memory._asdict()
        started["learner"] = Child(f"{_MODULE}learner").hand_over(ends.of["learner"], job)
    ends.close(keep="terminal")
    return RunProcesses(started, ends.of["terminal"], reports)


def make_recorder_job(
    plan: RunPlan, session: Path, more: Mapping[str, dict[str, str]]
) -> dict[str, Any]:
    """What a recording begins with, see `recorder`; its folder is made.

    `more` is metadata beside the run's.

    Raises:
        SteerdError: there can be no such folder.
    """
    with refusing(f"{session.parent}: ", "choose another place with --record"):
        session.parent.mkdir(parents=True, exist_ok=True)
    return {
        "path": str(session),
        "car": plan.options.car,
        "metadata": make_metadata(plan) | dict(more),
        "attachments": make_attachments(plan),
        "start_ns": plan.run.epoch_ns,
        "disk_free_min": plan.settings.record.disk_free_min_mb * 1_000_000,
        "flush_ns": plan.settings.record.flush_ms * 1_000_000,
    }
