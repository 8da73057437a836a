"""From each watchdog of the requirements to its code, its thresholds and the cell that shows it.

A cell is driven twice: as it is, where a transition must name the watchdog; and with the watchdog
silenced, where the cell must fail or another watchdog must step in. So a watchdog that nothing
needs, or that never trips, is found out.
"""

import importlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

from steerd.daemon.loop.findings import WATCHDOGS, Finding, summarise
from tests.safety.catalogue import BY_CODE
from tests.safety.matrix import Outcome, run_cell


class Trace(NamedTuple):
    """Where a watchdog lives and how it is shown."""

    code: str  # `module:name`
    thresholds: tuple[str, ...]  # of the car file's `[safety]`; none where nothing can be chosen
    cell: tuple[str, ...]  # (fault, phase) in which it trips
    behind: tuple[str, ...]  # watchdogs that would trip earlier in this cell; silenced
    also: str  # other tests of it


def trace(code: str, thresholds: str, cell: str, behind: str = "", also: str = "") -> Trace:
    """A row: words with blanks between them, a name alone is one of `loop.watchdogs`."""
    where = f"steerd.daemon.{code}" if ":" in code else f"steerd.daemon.loop.watchdogs:{code}"
    return Trace(where, *(tuple(each.split()) for each in (thresholds, cell, behind)), also)


TRACES = {
    "W1": trace("_check_mocap_age", "mocap_warn mocap_blind mocap_shortest mocap_longest",
          "M1 P5", also="live: mocap silent"),
    "W2": trace("_check_poses", "freeze_warn freeze_frames freeze_speed",
          "M2 P5", also="live: mocap frozen"),
    "W3": trace("loop.watchdogs_pose:is_sane", "invalid_frames quaternion_tolerance",
          "M8 P5", also="live: mocap NaN"),
    "W4": trace("loop.watchdogs_pose:_is_jump",
          "jump_speed jump_margin yaw_step jump_frames jump_window", "M4 P5",
          also="live: mocap jumps"),
    "W5": trace("_check_poses", "nis_frames nis_share nis_window mocap_rate", "C13 P6"),
    "W6": trace("_check_estimate", "sigma_position sigma_yaw", "C6 P5"),
    "W7": trace("_check_vesc", "telemetry_warn telemetry", "V4 P5", also="live: VESC mute"),
    "W8": trace("process.runner:Runner._check_queue", "out_queue out_ticks",
          "V1 P5", also="`test_runner.py`; live: unplugged"),
    "W9": trace("_step_vesc", "", "V18 P5"),
    "W10": trace("_check_vesc", "", "V19 P5", also="live: kill switch"),
    "W11": trace("_check_vesc", "", "V13 P5", also="live: VESC fault"),
    "W12": trace("_step_vesc", "", "C7 P5", also="live: VESC reboots"),
    "W13": trace("_check_vesc", "cell_warn cell cell_hold", "V16b P5"),
    "W14": trace("_check_temperature", "fet_warn fet motor_warn motor", "V17b P5"),
    "W15": trace("loop.findings:step_lateness", "late late_run late_share",
          "H12b P5", also="`test_findings.py`; live: SIGSTOP core"),
    "W16": trace("process.guard:ProcessGuard.is_silent", "guardian",
          "H6 P5", also="`test_runner.py`; live: SIGKILL, SIGSTOP guardian"),
    "W17": trace("_check_path", "lateral_warn lateral lateral_hold lateral_max", "C9 P5"),
    "W18": trace("_check_path", "heading_warn heading", "C8 P6"),
    "W19": trace("_check_fence", "fence_warn fence_delay fence_margin brake_decel", "C5 P5"),
    "W20": trace("_is_fast", "overspeed_ratio overspeed_margin overspeed_hold",
          "C3 P4"),  # the launch window's limit is close; elsewhere W30 is sooner
    "W21": trace("_is_mismatched", "mismatch_speed mismatch_share mismatch_hold",
          "V21 P5", behind="W30"),
    "W22": trace("_is_blocked", "blocked_current blocked_speed blocked_hold",
          "C4 P5", behind="W5 W30"),
    "W23": trace("_step_saturation", "saturated saturated_warn saturated_hold", "C8 P4"),
    "W24": trace("_step_stop", "stop_share stop_lag stop_window stop_speed brake_decel",
          "V5 P5", behind="W30"),
    "W25": trace("_check_lease", "lease_warn lease", "Z8 P5", also="live: operator gone"),
    "W26": trace("process.runner:_is_lost", "recorder_full",
          "H7 P5", also="`test_runner.py`; live: SIGKILL, SIGSTOP recorder"),
    "W27": trace("process.runner:_is_lost", "gateway_full",
          "H8 P5", also="`test_runner.py`; live: SIGKILL, SIGSTOP gateway"),
    "W28": trace("process.runner:Runner._set_flags", "suspend_step",
          "H17 P5", also="`test_runner.py`"),
    "W29": trace("loop.loop:Loop.fail", "", "H13 P5", also="H13b to H13e; `test_runner.py`"),
    "W30": trace("loop.following:compare", "follow_share follow_noise follow_hold follow_distance",
          "C10 P5"),
    # The filter refuses the poses of a car that turns the other way.
    "W31": trace("loop.following:measure_turns",
          "follow_share follow_noise follow_steer follow_hold follow_distance", "C13 P5",
          behind="W5", also="`shown.py`"),
}  # fmt: skip


def find_code(code: str) -> Any:
    module, _, path = code.partition(":")
    found: Any = importlib.import_module(module)
    for name in path.split("."):
        found = getattr(found, name)
    return found


@contextmanager
def silenced(*ids: str) -> Iterator[None]:
    """While this lasts, the supervisor hears nothing of these watchdogs."""

    def summarise_others(findings: Sequence[Finding]) -> tuple[int, str]:
        return summarise(finding for finding in findings if finding.id not in ids)

    with patch("steerd.daemon.loop.findings.summarise", summarise_others):
        yield


def run_trace(id: str) -> tuple[Outcome, Outcome]:
    """A watchdog's cell as it is, and without the watchdog."""
    code, phase = TRACES[id].cell
    behind = TRACES[id].behind
    with silenced(*behind):
        shown = run_cell(BY_CODE[code], phase)
    with silenced(id, *behind):
        return shown, run_cell(BY_CODE[code], phase)


def trips(id: str, outcome: Outcome) -> bool:
    """Whether a transition of the cell names the watchdog."""
    return any(reason.startswith(f"{id} ") for reason in outcome.reasons)


def write_trace(outside: Mapping[str, str]) -> list[str]:
    """The table for docs/reference/safety-matrix.md; drives every watchdog's cell twice."""
    lines = ["| watchdog | shown by | without it |", "|---|---|---|"]
    for id, row in TRACES.items():
        shown, without = run_trace(id)
        behind = f" (without {', '.join(row.behind)})" if row.behind else ""
        ms = f"{shown.stop_s * 1e3:.0f} ms" if shown.stop_s < 10.0 else "by the VESC's timeout"
        words = f"{' '.join(row.cell)}{behind}, {ms}", outside.get(id), row.also
        cell = "; ".join(filter(None, words))
        lines.append(f"| {id} {WATCHDOGS[id].name} | {cell} | {_loss(without)} |")
    return lines


def _loss(without: Outcome) -> str:
    """What became of the cell without its watchdog."""
    others = [reason for reason in without.reasons if reason not in ("stop asked for", "stopped")]
    effect = others[0].split(":")[0] if others else "no other watchdog"
    return f"**fails**, {effect}" if without.wrong else effect
