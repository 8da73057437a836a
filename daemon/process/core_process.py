"""The control core as a process: no zenoh, no mcap, no torch, no thread but the one in sigwait."""

import gc
import os
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from itertools import compress
from operator import attrgetter

import steerd.controller.build  # noqa: F401, loads while the parent makes the plan
from steerd.daemon.assembly.build import RunPlan, read_job
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc import signals
from steerd.daemon.ipc.pipe_records import PipeRecord, PipeWriter, Sink, is_learnt_from, pack_record
from steerd.daemon.loop.core import Core, make_core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.guard import ProcessGuard
from steerd.daemon.process.realtime import enter_realtime, settle_memory
from steerd.daemon.process.runner import CoreLinks, Runner
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.mocap_link.sockets import MocapReceiver, make_receiver
from steerd.mocap_link.zenoh_pose import BusPoseSource, make_bus_source
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.vesc_link.transport import Port, PortError, open_port

STATUS_PERIOD_NS = 100_000_000  # time between two records of the same kind for the terminal
_RARE = (topics.DIAGNOSTICS.name, topics.TRANSITION.name, topics.PARAMETERS.name)
_SHOWN = (topics.STATE.name, topics.TICK.name, *_RARE)


_TAKES: dict[str, Callable[[PipeRecord], bool]] = {
    "recorder": attrgetter("topic.logged"),
    "gateway": attrgetter("topic.on_bus"),
    "learner": is_learnt_from,
    "view": attrgetter("topic.on_bus"),
}
"""What each reader takes; a drive goes on without learner or viewer: the runner watches neither."""


def pipes_sink(pipes: Mapping[str, PipeWriter]) -> Sink:
    """A sink that writes into each pipe the records that its reader takes, packed once for all."""
    takers = [(pipe, _TAKES[name]) for name, pipe in pipes.items()]

    def sink(records: list[PipeRecord], t_ns: int) -> None:
        packed = [pack_record(record) for record in records]
        for pipe, takes in takers:
            pipe.write(list(compress(packed, map(takes, records))), t_ns)

    return sink


def status_sink(pipe: PipeWriter) -> Sink:
    """A sink for the terminal: transitions and diagnostics at once, the rest ten times a second."""
    due = 0

    def sink(records: list[PipeRecord], t_ns: int) -> None:
        nonlocal due
        ticks = t_ns >= due
        due = t_ns + STATUS_PERIOD_NS if ticks else due
        chosen = [r for r in records if r.topic.name in (_SHOWN if ticks else _RARE)]
        pipe.write([pack_record(record) for record in chosen], t_ns)

    return sink


def make_mocap(plan: RunPlan) -> MocapReceiver | BusPoseSource:
    """The mocap source that the options name.

    Raises:
        SteerdError: the address makes no sense, or its host does not resolve.
    """
    text = plan.options.mocap or ""
    try:
        url = parse_mocap_url(text)
        if url.key:
            return make_bus_source(url, plan.settings.ingest)
        return make_receiver(url, plan.settings.ingest)
    except ValueError as error:
        raise SteerdError(f"--mocap {text}: {error}", "", ExitCode.USAGE) from None
    except OSError as error:
        hint = "check the address, and that this machine is on the mocap network"
        raise SteerdError(str(error), hint, ExitCode.UNREADABLE) from None


def make_opener(url: str) -> Callable[[], Port]:
    """What opens the port, which is opened now already: a wrong one is a SteerdError at once."""
    try:
        waiting = [open_port(url)]
    except PortError as error:
        raise SteerdError(str(error), error.hint, ExitCode.UNREADABLE) from None
    return lambda: waiting.pop() if waiting else open_port(url)


def serve(given: Job) -> int:
    """The process."""
    fds, job = given
    plan = read_job(job, design=True)
    open_again = make_opener(plan.options.port or "")
    mocap = make_mocap(plan)
    pipes = {name: PipeWriter(fds[name]) for name in _TAKES if name in fds}
    sinks = [pipes_sink(pipes), status_sink(PipeWriter(fds["status"]))]
    clock = MonotonicClock()
    core = make_core(plan, sinks)
    latch_stray_exceptions(core)
    requests = tuple(socket.socket(fileno=fds[name]) for name in ("parent", "gateway_requests"))
    designs = socket.socket(fileno=fds["designs"]) if "designs" in fds else None
    for sock in (*requests, *((designs,) if designs else ())):
        sock.setblocking(False)
    links = CoreLinks(
        pipes["recorder"], pipes["gateway"], requests, signals.make_stop_signal_pipe(), designs
    )
    report = enter_realtime()
    design = plan.controller.report.describe()
    given.say_ready(realtime=report.refused, design=design)
    silent_s = plan.settings.thresholds.guardian
    guard = ProcessGuard(report.fifo, simulated=plan.options.simulated, silent_s=silent_s)
    runner = Runner(core, clock, open_again, mocap, links, guard, signals.make_notify(os.environ))
    settle_memory()
    runner.run()
    if core.error is not None:
        traceback.print_exception(core.error)
        return ExitCode.INTERNAL
    lost = core.flags & (Flag.RECORDER_LOST | Flag.GATEWAY_LOST)
    return ExitCode.STOPPED if core.loop.faulted or lost else ExitCode.OK


def latch_stray_exceptions(core: Core) -> None:
    """An exception in a thread or a destructor has no caller; it stops the car too (W29)."""

    def take(error: BaseException | None) -> None:
        core.latch_exception(error or RuntimeError("an exception without a value"))

    sys.unraisablehook = lambda raised: take(raised.exc_value)
    threading.excepthook = lambda raised: take(raised.exc_value)


def _begin() -> None:
    signals.block_stop_signals()
    signals.wake_at_parents_end()
    gc.freeze()  # what imports made stays: no need to search it for garbage again


if __name__ == "__main__":
    run_process(serve, begin=_begin)
