"""The learner's process, as the terminal starts it: what it is given, and its pipes."""

from collections.abc import Mapping
from typing import Any

from steerd.daemon.assembly.build import RunPlan

REPORTS = ("report_recorder", "report_gateway")
"""Pipes from the learner, each to the process that its name ends with."""


def learner_pipes(plan: RunPlan) -> tuple[str, ...]:
    """Names of the pipes that a run with `--learn` has more."""
    return ("learner", *REPORTS) if plan.options.learn else ()


def core_ends(pipes: Mapping[str, tuple[int, int]]) -> dict[str, int]:
    """The ends that the core writes to."""
    return {name: ends[1] for name, ends in pipes.items() if name not in REPORTS}


def reader_fds(pipes: Mapping[str, tuple[int, int]], reader: str) -> dict[str, int]:
    """What a process reads reports from; empty without a learner."""
    name = f"report_{reader}"
    return {name: pipes[name][0]} if name in pipes else {}


def learner_fds(pipes: Mapping[str, tuple[int, int]]) -> dict[str, int]:
    """What the learner reads and writes."""
    return {"pipe": pipes["learner"][0]} | {name: pipes[name][1] for name in REPORTS}


def make_learner_job(plan: RunPlan, epoch_ns: int) -> dict[str, Any]:
    """Car file and scaling, see `learner.make_learner_feed`."""
    return {
        "epoch_ns": epoch_ns,
        "car": plan.settings.file.text,
        "path": str(plan.settings.file.path),
        "erpm_gain": plan.settings.scaling.erpm_gain,
        "erpm_offset": plan.settings.scaling.erpm_offset,
    }
