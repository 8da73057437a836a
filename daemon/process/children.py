"""The processes of a run: jobs on standard input, ended by closing their pipes."""

# Why: docs/decisions/safety.md#d16

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.session_meta import make_attachments, make_metadata
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.pipe_records import make_pipe
from steerd.daemon.process.learner_job import (
    NO_MEMORY,
    OURS,
    core_ends,
    learner_fds,
    learner_pipes,
    make_design_ends,
    make_learner_job,
    reader_fds,
)
from steerd.daemon.process.learner_memory import LearnerMemory, recall_learnt
from steerd.daemon.process.page_job import make_page_job
from steerd.daemon.process.prepared import CORE, Prepared, hand_over, prepare
from steerd.daemon.process.view_job import make_view_job
from steerd.daemon.settings.run_options import ControllerKind, encode_options
from steerd.mocap_link.mocap_url import parse_mocap_url

READY_S = 30.0
"""Longest time until a process is ready [s]."""
END_S, VIEWER_END_S = 10.0, 2.0
"""Longest time until a process has ended, before it is killed [s]."""


@dataclass
class Child:
    """A process and the descriptor on which it reports that it is ready."""

    process: subprocess.Popen[bytes]
    ready_fd: int

    def wait_ready(self, name: str) -> str:
        """Its first line.

        Raises:
            SteerdError: it ended, or nothing came in time.
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
        return line.decode().strip()


def spawn(
    module: str, fds: Mapping[str, int], job: Mapping[str, Any], keep: socket.socket | None = None
) -> Child:
    """Start `python -m module` with these descriptors and the job as JSON on standard input.

    It gets a process group of its own: Ctrl-C reaches this terminal alone. `keep` stays open there
    too; the job names its descriptor.
    """
    ready_fd, child_fd = os.pipe()
    every = {**fds, "ready": child_fd}
    process = subprocess.Popen(
        [sys.executable, "-m", module, *map(str, every.values())],
        stdin=subprocess.PIPE,
        pass_fds=(*every.values(), *(() if keep is None else (keep.fileno(),))),
        process_group=0,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )
    os.close(child_fd)
    if process.stdin is not None:
        process.stdin.write(json.dumps(job).encode())
        process.stdin.close()
    return Child(process, ready_fd)


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
        try:
            self.child.process.wait(VIEWER_END_S)
        except subprocess.TimeoutExpired:
            self.child.process.kill()
            self.child.process.wait()


def start_page(plan: RunPlan) -> Page:
    """Start the live page of a car whose bus is up.

    Raises:
        SteerdError: its port is taken, or it cannot reach the car.
    """
    read_fd, write_fd = os.pipe()
    child = spawn("steerd.daemon.process.page", {"lifeline": read_fd}, make_page_job(plan))
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
        core, recorder, gateway: the processes.
        viewer: the process of `--view`, or None.
        page: of `--page`, or None.
        learner: of `--learn`, or None.
        viewer_requests: what the viewer asks of this terminal, with `--view-sets`.
        requests: this terminal's end of the socket for requests to the core.
        status_fd: records for this terminal.
        session: file of the recording.
        core_report: what the core reported when it was ready.
        report_fd: the learner's reports for this terminal, with `--learn`.
        view_url: where a viewer connects, with `--view`.
    """

    core: Child
    recorder: Child
    gateway: Child
    viewer: Child | None
    requests: socket.socket
    status_fd: int
    session: Path
    core_report: dict[str, Any]
    page: Page | None = None
    viewer_requests: socket.socket | None = None
    learner: Child | None = None
    report_fd: int | None = None
    view_url: str = ""

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
        for child in (self.recorder, self.gateway):
            try:
                child.process.wait(END_S)
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
        _end_guest(self.viewer, "viewer")
        _end_guest(self.learner, "learner")
        if self.page is not None:
            self.page.end()
        code = code or self.recorder.process.returncode
        return ExitCode.STOPPED if code < 0 else code


def _end_guest(child: Child | None, name: str) -> None:
    """A viewer or learner that failed or hangs is reported; the exit code stays the core's."""
    if child is None:
        return
    try:
        code = child.process.wait(VIEWER_END_S)
    except subprocess.TimeoutExpired:
        child.process.kill()
        code = child.process.wait()
    if code:
        print(f"note: the {name} ended with code {code}", file=sys.stderr)


def start_learner(
    plan: RunPlan,
    pipes: Mapping[str, tuple[int, int]],
    epoch_ns: int,
    designs: tuple[socket.socket, ...] = (),
    memory: LearnerMemory = NO_MEMORY,
) -> Child | None:
    """Start the learner of `--learn`; nobody waits for it."""
    if not plan.options.learn:
        return None
    job = make_learner_job(plan, epoch_ns, memory)
    return spawn("steerd.daemon.process.learner", learner_fds(pipes, designs), job)


def start_processes(
    plan: RunPlan,
    session: Path,
    boot_id: int,
    epoch_ns: int,
    leased: bool,
    core: Prepared | None = None,
) -> RunProcesses:
    """Start recorder, gateway, core and, with `--view`, the viewer.

    `core` is the control core's process where it was prepared already.

    Raises:
        SteerdError: one of them failed to start, with its own text.
    """
    viewed = ("view",) if plan.options.view else ()
    names = ("recorder", "gateway", "status", *viewed, *learner_pipes(plan))
    pipes = {name: make_pipe() for name in names}
    gateway_end, gateway_core_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    terminal_end, terminal_core_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    designs = make_design_ends(plan)
    memory = recall_learnt(plan, session, epoch_ns + time.monotonic_ns())
    fds = core_ends(pipes, designs) | {
        "parent": terminal_core_end.fileno(),
        "gateway_requests": gateway_core_end.fileno(),
    }
    started: list[Child] = []
    recording = False
    try:
        # All at once: each takes a second for its imports. What the core writes before the others
        # are ready waits in its pipes.
        meta = make_metadata(plan, boot_id, epoch_ns, leased=leased) | dict(memory.metadata)
        started.append(_start_recorder(plan, session, meta, epoch_ns, pipes))
        started.append(_start_gateway(plan, pipes, gateway_end.fileno(), boot_id))
        job = _make_core_job(plan, boot_id, epoch_ns, leased)
        started.append(_start_core(core or prepare(CORE), fds, job))
        viewer_requests = None
        if viewed:
            viewer, viewer_requests = _start_viewer(plan, pipes["view"][0])
            started.append(viewer)
        recorder, gateway, driver, *others = started
        _expect_ready(recorder, "recorder", ExitCode.UNREADABLE)
        recording = True
        core_report = _read_core_report(driver)
        _expect_ready(gateway, "gateway", ExitCode.UNREACHABLE)
        view_url = others[0].wait_ready("viewer") if others else ""
        if others and not view_url.startswith("ws:"):
            raise SteerdError(view_url, "", ExitCode.UNREADABLE)
        page = None if plan.options.page is None else start_page(plan)
    except SteerdError:
        ends = (gateway_end, gateway_core_end, terminal_end, terminal_core_end, *designs)
        _end_started(started, pipes, ends)
        if recording:
            session.unlink(missing_ok=True)
        raise
    learner = start_learner(plan, pipes, epoch_ns, designs, memory)
    for name in pipes:
        os.close(pipes[name][1])
        if name not in OURS:
            os.close(pipes[name][0])
    for end in (gateway_end, gateway_core_end, terminal_core_end, *designs):
        end.close()
    return RunProcesses(
        driver, recorder, gateway, others[0] if others else None, terminal_end, pipes["status"][0],
        session, core_report, page, viewer_requests, learner,
        reader_fds(pipes, "terminal").get("report_terminal"), view_url,
    )  # fmt: skip


def _make_core_job(plan: RunPlan, boot_id: int, epoch_ns: int, leased: bool) -> dict[str, Any]:
    return {
        "options": encode_options(plan.options),
        "boot_id": boot_id,
        "epoch_ns": epoch_ns,
        "leased": leased,
    }


def _start_core(core: Prepared, fds: Mapping[str, int], job: Mapping[str, Any]) -> Child:
    ready_fd, child_fd = os.pipe()
    hand_over(core, {**fds, "ready": child_fd}, job)
    os.close(child_fd)
    return Child(core.process, ready_fd)


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


def _end_started(
    started: list[Child], pipes: Mapping[str, tuple[int, int]], ends: tuple[socket.socket, ...]
) -> None:
    """Close all descriptors, on which the started processes end; kill those that do not."""
    for pair in pipes.values():
        for fd in pair:
            os.close(fd)
    for end in ends:
        end.close()
    for child in started:
        try:
            child.process.wait(END_S)
        except subprocess.TimeoutExpired:
            child.process.kill()


def _start_recorder(
    plan: RunPlan,
    session: Path,
    meta: dict[str, dict[str, str]],
    epoch_ns: int,
    pipes: Mapping[str, tuple[int, int]],
) -> Child:
    try:
        session.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        hint = "choose another place with --record"
        raise SteerdError(
            f"{session.parent}: {error.strerror}", hint, ExitCode.UNREADABLE
        ) from None
    job = {
        "path": str(session),
        "car": plan.options.car,
        "metadata": meta,
        "attachments": make_attachments(plan),
        "start_ns": epoch_ns,
        "disk_free_min": plan.settings.record.disk_free_min_mb * 1_000_000,
        "flush_ns": plan.settings.record.flush_ms * 1_000_000,
    }
    fds = {"pipe": pipes["recorder"][0]} | reader_fds(pipes, "recorder")
    return spawn("steerd.daemon.process.recorder", fds, job)


def _start_viewer(plan: RunPlan, pipe_fd: int) -> tuple[Child, socket.socket | None]:
    """The viewer, and this terminal's end of its requests where it may set live parameters."""
    module, job = "steerd.daemon.process.view", make_view_job(plan)
    if not plan.options.view_sets:
        return spawn(module, {"pipe": pipe_fd}, job), None
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    child = spawn(module, {"pipe": pipe_fd}, {**job, "requests": theirs.fileno()}, keep=theirs)
    theirs.close()
    return child, ours


def _start_gateway(
    plan: RunPlan, pipes: Mapping[str, tuple[int, int]], requests_fd: int, boot_id: int
) -> Child:
    mocap = plan.options.mocap
    pose_key = (parse_mocap_url(mocap).key or None) if mocap else None
    job = {
        "listen": plan.options.listen,
        "lab": plan.options.lab,
        "insecure_lan": plan.options.insecure_lan,
        "car": plan.options.car,
        "pose_key": pose_key,
        "ros_domain": plan.options.ros_domain,
        "ros_drive": boot_id if plan.options.controller is ControllerKind.ROS2 else None,
    }
    fds = {"pipe": pipes["gateway"][0], "requests": requests_fd} | reader_fds(pipes, "gateway")
    return spawn("steerd.daemon.process.gateway", fds, job)
