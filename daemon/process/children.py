"""The processes of a run: jobs on standard input, ended by closing their pipes."""

# Why: docs/decisions/safety.md#d16

import contextlib
import json
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

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.session_meta import make_attachments, make_metadata
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.pipe_records import make_pipe
from steerd.daemon.process.child import CORE, Child, Prepared, hand_over, prepare, spawn
from steerd.daemon.process.learner_memory import make_learner_job, recall_learnt
from steerd.daemon.process.page_job import make_page_job
from steerd.daemon.process.view_job import make_view_job
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.mocap_link.mocap_url import parse_mocap_url

END_S, VIEWER_END_S = 10.0, 2.0
"""Longest time until a process has ended, before it is killed [s]."""
_MODULE = "steerd.daemon.process."


class Ends:
    """Descriptors of a run by process and name; who ends, or drops them, is noticed by the others.

    Attributes:
        of: descriptors of each process; those of `terminal` are this process's own.
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
            for reader in ("recorder", "gateway", "terminal"):
                self._pipe("learner", f"to_{reader}", reader, "reports")
        if options.adapt:
            self._socket("core", "designs", "learner", "designs")
        if options.view_sets:
            self._socket("view", "requests", "terminal", "view_requests")

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
class Page:
    """The live page's process, which ends when its lifeline closes.

    Attributes:
        child: the process.
        lifeline_fd: our end.
        url: where the page is.
    """

    child: Child
    lifeline_fd: int
    url: str

    def end(self) -> None:
        """Close the lifeline and wait; a page that hangs is ended."""
        os.close(self.lifeline_fd)
        _end(self.child, VIEWER_END_S)


def start_page(plan: RunPlan) -> Page:
    """Start the live page of a car whose bus is up.

    Raises:
        SteerdError: its port is taken, or it cannot reach the car.
    """
    read_fd, write_fd = os.pipe()
    child = spawn(f"{_MODULE}page", {"lifeline": read_fd}, make_page_job(plan))
    os.close(read_fd)
    try:
        line = child.wait_ready("page")
    except SteerdError:
        os.close(write_fd)
        raise
    if not line.startswith("http"):
        os.close(write_fd)
        raise SteerdError(line, "--page with another port", ExitCode.UNREACHABLE)
    return Page(child, write_fd, line)


@dataclass
class RunProcesses:
    """All processes of a run.

    Attributes:
        children: core, recorder and gateway; `viewer` and `learner` where they were asked for.
        fds: this terminal's descriptors: `status` gives records, `requests` and `view_requests` are
            sockets to the core and from the viewer, `reports` gives the learner's.
        session: file of the recording.
        core_report: what the core reported when it was ready.
        page: of `--page`, or None.
        view_url: where a viewer connects, with `--view`.
    """

    children: dict[str, Child]
    fds: dict[str, int]
    session: Path
    core_report: dict[str, Any]
    page: Page | None = None
    view_url: str = ""

    def __post_init__(self) -> None:
        self.requests = socket.socket(fileno=self.fds["requests"])
        asked = self.fds.get("view_requests")
        self.viewer_requests = None if asked is None else socket.socket(fileno=asked)

    @property
    def core(self) -> Child:
        """The control core."""
        return self.children["core"]

    def end(self) -> int:
        """Wait for the core, then for the others, which end when its pipes close.

        Returns:
            The core's exit code, or the recorder's where the session is not whole; a process that
            was killed is a safety stop.
        """
        code = self.core.process.wait()
        if code < 0:
            print(f"stopped: signal {-code} ended the control core", file=sys.stderr)
        for end in (self.requests, self.viewer_requests):
            if end is not None:
                end.close()
        recorded, _ = (_end(self.children[name], END_S) for name in ("recorder", "gateway"))
        code = code or recorded
        for name in self.children.keys() & {"viewer", "learner"}:
            if lost := _end(self.children[name], VIEWER_END_S):  # the exit code stays the core's
                print(f"note: the {name} ended with code {lost}", file=sys.stderr)
        if self.page is not None:
            self.page.end()
        return ExitCode.STOPPED if code < 0 else code


def _end(child: Child, seconds: float) -> int:
    """Its exit code; one that has not ended in time is killed."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        return child.process.wait(seconds)
    child.process.kill()
    return child.process.wait()


def start_processes(
    plan: RunPlan,
    session: Path,
    boot_id: int,
    epoch_ns: int,
    leased: bool,
    core: Prepared | None = None,
) -> RunProcesses:
    """Start recorder, gateway, core and, where they are asked for, viewer, page and learner.

    `core` is the control core's process where it was prepared already.

    Raises:
        SteerdError: one of them failed to start, with its own text.
    """
    ends, memory = Ends(plan.options), recall_learnt(plan, session, epoch_ns + time.monotonic_ns())
    started: dict[str, Child] = {}
    recording = False
    try:
        # All at once: each takes a second for its imports. What the core writes before the others
        # are ready waits in its pipes.
        meta = make_metadata(plan, boot_id, epoch_ns, leased=leased) | dict(memory.metadata)
        job = _make_recorder_job(plan, session, meta, epoch_ns)
        started["recorder"] = spawn(f"{_MODULE}recorder", ends.of["recorder"], job)
        started["gateway"] = spawn(f"{_MODULE}gateway", ends.of["gateway"], _make_gateway_job(plan))
        job = {"options": encode_options(plan.options), "boot_id": boot_id, "epoch_ns": epoch_ns}
        job["leased"] = leased
        started["core"] = hand_over(core or prepare(CORE), ends.of["core"], job)
        if plan.options.view:
            started["viewer"] = spawn(f"{_MODULE}view", ends.of["view"], make_view_job(plan))
        _expect_ready(started["recorder"], "recorder", ExitCode.UNREADABLE)
        recording = True
        report, view_url = _wait_ready(started)
        page = None if plan.options.page is None else start_page(plan)
    except SteerdError:
        ends.close()
        for child in started.values():
            _end(child, END_S)
        if recording:
            session.unlink(missing_ok=True)
        raise
    if plan.options.learn:  # nobody waits for it
        job = make_learner_job(plan, epoch_ns, memory)
        started["learner"] = spawn(f"{_MODULE}learner", ends.of["learner"], job)
    ends.close(keep="terminal")
    return RunProcesses(started, ends.of["terminal"], session, report, page, view_url)


def _wait_ready(started: Mapping[str, Child]) -> tuple[dict[str, Any], str]:
    """What the core reports, and the viewer's address, once all are ready.

    Raises:
        SteerdError: one is not, with its own text.
    """
    report = _read_core_report(started["core"])
    _expect_ready(started["gateway"], "gateway", ExitCode.UNREACHABLE)
    viewer = started.get("viewer")
    view_url = viewer.wait_ready("viewer") if viewer else ""
    if viewer and not view_url.startswith("ws:"):
        raise SteerdError(view_url, "", ExitCode.UNREADABLE)
    return report, view_url


def _read_core_report(core: Child) -> dict[str, Any]:
    """What a core reports that is ready.

    Raises:
        SteerdError: it is not, with its own text.
    """
    report: dict[str, Any] = json.loads(core.wait_ready("control core"))
    if "what" in report:
        raise SteerdError(report["what"], report["hint"], ExitCode(report["code"]))
    return report


def _expect_ready(child: Child, name: str, code: ExitCode) -> None:
    line = child.wait_ready(name)
    if line != "ready":
        taken = "already in use" in line and name == "gateway"
        hint = "end that one, or --listen tcp/127.0.0.1:7448" if taken else ""
        raise SteerdError(line, hint, code)


def _make_recorder_job(
    plan: RunPlan, session: Path, meta: dict[str, dict[str, str]], epoch_ns: int
) -> dict[str, Any]:
    try:
        session.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        hint = "choose another place with --record"
        raise SteerdError(
            f"{session.parent}: {error.strerror}", hint, ExitCode.UNREADABLE
        ) from None
    return {
        "path": str(session),
        "car": plan.options.car,
        "metadata": meta,
        "attachments": make_attachments(plan),
        "start_ns": epoch_ns,
        "disk_free_min": plan.settings.record.disk_free_min_mb * 1_000_000,
        "flush_ns": plan.settings.record.flush_ms * 1_000_000,
    }


def _make_gateway_job(plan: RunPlan) -> dict[str, Any]:
    mocap = plan.options.mocap or ""
    pose_key = None
    with contextlib.suppress(ValueError):  # the core tells what is wrong with the address
        pose_key = parse_mocap_url(mocap).key or None
    return {
        "listen": plan.options.listen,
        "lab": plan.options.lab,
        "insecure_lan": plan.options.insecure_lan,
        "car": plan.options.car,
        "pose_key": pose_key,
        "ros_domain": plan.options.ros_domain,
    }
