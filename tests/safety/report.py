"""Run the whole matrix and write the tables of the safety pages: `python -m tests.safety.report`.

`--check` only says whether every cell is good. `--keep FILE` writes each cell as it comes and does
not drive those that are there: the matrix of one state of the code, in slices.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from joblib import Parallel, delayed

from steerd.daemon.settings.thresholds import BOUNDS, Thresholds
from tests.safety.catalogue import BY_CODE, FAULT_CASES, FaultCase, Must
from tests.safety.live_faults import FAULTS
from tests.safety.live_faults import PHASES as LIVE_PHASES
from tests.safety.matrix import MOVING, Outcome, list_cells, run_cell
from tests.safety.outside import list_outside
from tests.safety.trace import TRACES, write_trace

PAGES = Path(__file__).parents[2] / "docs" / "reference"


def run_named(cell: tuple[str, str]) -> Outcome:
    return run_cell(BY_CODE[cell[0]], cell[1])


def read_kept(path: Path | None) -> dict[tuple[str, str], Outcome]:
    """The cells that were driven already, by fault and phase."""
    if path is None or not path.exists():
        return {}
    kept = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        found = json.loads(line)
        lists = {key: tuple(value) for key, value in found.items() if isinstance(value, list)}
        kept[found["code"], found["phase"]] = Outcome(**(found | lists))
    return kept


def drive_matrix(keep: Path | None, jobs: int) -> list[Outcome]:
    """Every cell: read where it was kept, driven where it was not."""
    cells, kept = list_cells(), read_kept(keep)
    left = [cell for cell in cells if cell not in kept]
    driven = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(run_named)(cell) for cell in left
    )
    for outcome in driven:
        kept[outcome.code, outcome.phase] = outcome
        if keep is not None:
            with keep.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
    return [kept[cell] for cell in cells]


def show(case: FaultCase, cells: Sequence[Outcome]) -> str:
    """A fault's line: the slowest stop and the longest way of the cells that drive, what failed."""
    driven = [cell for cell in cells if cell.phase in MOVING and cell.phase != "P8"]
    stops = [cell.stop_s for cell in driven if isfinite(cell.stop_s)]
    stop = f"{max(stops) * 1e3:.0f}" if stops else ""
    way = f"{max(cell.distance_m for cell in driven):.2f}" if driven else ""
    must = case.must in (Must.STOP_HARD, Must.STOP_SOFT, Must.ESTOP)
    wrong = "".join(f" **{cell.phase}: {'; '.join(cell.wrong)}**" for cell in cells if cell.wrong)
    aim = f"{case.must.value} {case.bound_s * 1e3:.0f}" if must else "lane"
    return f"| {case.code} {case.name}{wrong} | {aim} | {stop} | {way} |"


def write_matrix(outcomes: Sequence[Outcome]) -> list[str]:
    """The table of faults; those that must stop nothing, and did not, are only named."""
    good = sum(not outcome.wrong for outcome in outcomes)
    lines = [
        f"{len(FAULT_CASES)} faults, {len(outcomes)} cells, {good} good.",
        "",
        "| fault | must, within [ms] | slowest stop [ms] | longest way [m] |",
        "|---|---|---|---|",
    ]
    quiet = []
    for case in FAULT_CASES:
        cells = [outcome for outcome in outcomes if outcome.code == case.code]
        if case.must is Must.LIVE_ON and not any(cell.wrong for cell in cells):
            quiet.append(f"{case.code} {case.name}")
        else:
            lines.append(show(case, cells))
    named = ", ".join(quiet)
    return [*lines, "", f"These must stop nothing, and did not: {named}."]


def write_live(log: Path) -> list[str]:
    """The real-time cells of a log, one fault a line: milliseconds to the first stop byte."""
    rows = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    found = {(row["name"], row["phase"]): row for row in rows}
    lines = ["| fault | " + " | ".join(LIVE_PHASES) + " | reason in P5 |", "|---|" + "---|" * 5]
    for name, fault in FAULTS.items():
        cells = []
        for phase in fault.phases.split():
            row = found[name, phase]
            cells.append("ok" if row["stop_ms"] < 0.0 else f"{row['stop_ms']:.0f}")
        shown = dict(zip(fault.phases.split(), cells, strict=True))
        reason = found.get((name, "P5"), {"reason": ""})["reason"].split(":")[0].split(";")[0]
        line = " | ".join(shown.get(phase, "") for phase in LIVE_PHASES)
        lines.append(f"| {name} | {line} | {reason} |")
    return lines


def write_thresholds() -> list[str]:
    """Watchdogs, default and compiled-in range of each threshold, from the code."""
    lines = ["| threshold | default | car file may say |", "|---|---|---|"]
    default = Thresholds()
    for name, b in BOUNDS.items():
        used = ", ".join(id for id, trace in TRACES.items() if name in trace.thresholds)
        value = f"{getattr(default, name):.4g} {b.unit}".strip()
        lines.append(f"| `{name}` {used} | {value} | {b.low:.4g}..{b.high:.4g} |")
    return lines


def replace_section(text: str, name: str, lines: Iterable[str]) -> str:
    """The page with the lines between a section's markers replaced."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if begin not in text or end not in text:
        raise ValueError(f"the page has no section {name}")
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    return head + begin + "\n" + "\n".join(lines) + "\n" + end + tail


def write_sections(page: str, **sections: Iterable[str]) -> None:
    path = PAGES / page
    text = path.read_text(encoding="utf-8")
    for name, lines in sections.items():
        text = replace_section(text, name, lines)
    path.write_text(text, encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--keep", type=Path, metavar="FILE.jsonl", help="cells, as they come")
    text = "write the table of the real-time cells alone"
    parser.add_argument("--live", type=Path, metavar="LOG.jsonl", help=text)
    args = parser.parse_args(argv)
    if args.live is not None:
        write_sections("safety-matrix.md", live=write_live(args.live))
        return 0
    outcomes = drive_matrix(args.keep, args.jobs)
    bad = [outcome for outcome in outcomes if outcome.wrong]
    for outcome in bad:
        print(outcome.code, outcome.phase, *outcome.wrong)
    print(f"{len(outcomes)} cells, {len(bad)} bad")
    if not args.check:
        write_sections("safety-watchdogs.md", thresholds=write_thresholds())
        write_sections(
            "safety-matrix.md", trace=write_trace(list_outside()), matrix=write_matrix(outcomes)
        )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
