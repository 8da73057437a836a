"""The learner's process, as the terminal starts it: what it is given, and its pipes."""

import socket
from collections.abc import Mapping
from typing import Any

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.process.learner_memory import LearnerMemory
from steerd.daemon.settings.run_options import encode_options

REPORTS = ("report_recorder", "report_gateway", "report_terminal")
"""Pipes from the learner, each to the process that its name ends with."""
NO_MEMORY = LearnerMemory()
OURS = ("status", "report_terminal")
"""Pipes that are read in this terminal's own process."""


def learner_pipes(plan: RunPlan) -> tuple[str, ...]:
    """Names of the pipes that a run with `--learn` has more."""
    return ("learner", *REPORTS) if plan.options.learn else ()


def make_design_ends(plan: RunPlan) -> tuple[socket.socket, ...]:
    """Where the learner proposes designs and where the core reads them; none without `--adapt`."""
    if not plan.options.adapt:
        return ()
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def core_ends(
    pipes: Mapping[str, tuple[int, int]], designs: tuple[socket.socket, ...] = ()
) -> dict[str, int]:
    """The ends that the core writes to, and where it reads designs."""
    written = {name: ends[1] for name, ends in pipes.items() if name not in REPORTS}
    return written | ({"designs": designs[1].fileno()} if designs else {})


def reader_fds(pipes: Mapping[str, tuple[int, int]], reader: str) -> dict[str, int]:
    """What a process reads reports from; empty without a learner."""
    name = f"report_{reader}"
    return {name: pipes[name][0]} if name in pipes else {}


def learner_fds(
    pipes: Mapping[str, tuple[int, int]], designs: tuple[socket.socket, ...] = ()
) -> dict[str, int]:
    """What the learner reads and writes."""
    fds = {"pipe": pipes["learner"][0]} | {name: pipes[name][1] for name in REPORTS}
    return fds | ({"designs": designs[0].fileno()} if designs else {})


def make_learner_job(
    plan: RunPlan, epoch_ns: int, memory: LearnerMemory = NO_MEMORY
) -> dict[str, Any]:
    """Car file, scaling and memory, see `learner.make_learner_feed` and `make_keeper`."""
    return {
        "epoch_ns": epoch_ns,
        "car": plan.settings.file.text,
        "posterior": plan.settings.file.posterior,
        "path": str(plan.settings.file.path),
        "erpm_gain": plan.settings.scaling.erpm_gain,
        "erpm_offset": plan.settings.scaling.erpm_offset,
        "memory": memory.memory,
        "page": memory.page,
        "page_refused": memory.refused,
        "about": memory.about,
        "adapt": encode_options(plan.options) if plan.options.adapt else "",
    }
