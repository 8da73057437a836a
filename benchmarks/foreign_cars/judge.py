"""Ask the tool about cases by the commands of the README, as subprocesses, one row a case."""

import json
import os
import resource
import shlex
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from rich.progress import Progress

from benchmarks.foreign_cars.cases import Case, healthy_logs, later_logs, write_logs
from benchmarks.foreign_cars.plants import make_plant

Json = dict[str, Any]

TOOL = "steerd"
ROWS = "rows.jsonl"
CPU_LIMIT = 900
"""CPU time after which a command counts as failed [s]: a busy machine costs no verdicts."""
_KEPT = ("schema", "verdict", "causes", "candidates")


class ToolError(RuntimeError):
    """A command of the tool failed; the message is its last lines."""


def run_tool(tool: str, *words: str) -> float:
    """Run a command; its CPU seconds.

    Raises:
        ToolError: its exit code is not 0, or it takes more than `CPU_LIMIT`.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    line = [*shlex.split(tool), *words]
    one = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    done = subprocess.run(
        line, capture_output=True, text=True, check=False, env={**os.environ, **one},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT, CPU_LIMIT)),
    )  # fmt: skip
    if done.returncode != 0:
        raise ToolError(f"{words[0]}: exit {done.returncode}: {done.stderr.strip()[-400:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _imported(tool: str, tables: Iterable[Path]) -> list[str]:
    """Sessions of tables, imported if they are not there yet; what was cut off is done again."""
    sessions = []
    for table in tables:
        session = table.with_suffix(".mcap")
        if not session.exists():
            session.with_name(f"{session.name}.partial").unlink(missing_ok=True)
            words = (str(table), "--map", str(table.with_name("map.toml")), "-o", str(session))
            run_tool(tool, "import", "csv", *words)
        sessions.append(str(session))
    return sessions


def identify_car(case: Case, out: Path, tool: str = TOOL, taped: bool = True) -> Path:
    """Identify a case's car from its healthy drives; kept if done before.

    Args:
        case: any case of the car.
        out: folder of all work.
        tool: command that starts the tool.
        taped: the wheelbase is measured with a tape and stated, as the README advises.

    Returns:
        The car's folder: `car.toml`, `identify.json` and `identify.cpu`, or `identify.error`.
    """
    folder = out / "cars" / case.car
    clock, failed = folder / "identify.cpu", folder / "identify.error"
    if clock.exists() or failed.exists():
        return folder
    tables = write_logs(folder, "healthy", healthy_logs(case))
    try:
        sessions = _imported(tool, tables)
        words = ("-o", str(folder / "car.toml"), "--json", str(folder / "identify.json"))
        if taped:
            words = (*words, "--wheelbase", f"{_tape(case):.3f}")
        clock.write_text(f"{run_tool(tool, 'identify', *sessions, *words):.2f}\n")
    except ToolError as error:
        failed.write_text(f"{error}\n")
    return folder


def _tape(case: Case) -> float:
    """The distance of a car's axles to a millimetre [m]."""
    truth = make_plant(case.plant, case.seed).truth
    return round(truth["lf"] + truth["lr"], 3)


def _diagnosed(case: Case, out: Path, tool: str, row: Json, base: Path) -> None:
    """The row with what the tool says of a case."""
    folder = out / "cases" / case.name
    logs, labels = later_logs(case)
    row["truths"] = labels
    sessions = _imported(tool, write_logs(folder, "later", logs))
    verdict = folder / "gap.json"
    words = ("--base", str(base / "car.toml"), "--json", str(verdict))
    row["diagnose_cpu"] = round(run_tool(tool, "diagnose", *sessions, *words), 2)
    answer = json.loads(verdict.read_text())
    row["gap"] = {key: answer.get(key) for key in _KEPT}
    row["errors"] = {when: answer["gap"][when]["errors"] for when in ("before", "after")}


def judge_case(case: Case, out: Path, tool: str = TOOL) -> Json:
    """The row of one case: what is hidden, what the tool says, how long it took, or the error."""
    base = out / "cars" / case.car
    row: Json = {"case": asdict(case), "name": case.name, "kind": case.kind}
    row["car"] = make_plant(case.plant, case.seed).truth
    try:
        if (base / "identify.error").exists():
            raise ToolError((base / "identify.error").read_text())
        row["identify_cpu"] = float((base / "identify.cpu").read_text())
        learnt = json.loads((base / "identify.json").read_text())
        row["identify"] = {key: learnt[key] for key in ("parameters", "held_out")}
        _diagnosed(case, out, tool, row, base)
    except (ToolError, FloatingPointError, ZeroDivisionError) as error:
        row["error"] = str(error)[-600:]
    return row


def _side_by_side(tasks: Sequence[Any], title: str, jobs: int) -> Iterable[Any]:
    with Progress(transient=True) as progress:
        bar = progress.add_task(title, total=len(tasks))
        for result in Parallel(n_jobs=jobs, return_as="generator_unordered")(tasks):
            progress.advance(bar)
            yield result


def read_rows(path: Path) -> list[Json]:
    """Rows written so far; none without a file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def judge(
    cases: Sequence[Case], out: Path, tool: str = TOOL, jobs: int = 1, taped: bool = True
) -> list[Json]:
    """Judge cases that have no row yet; a broken run is taken up again.

    Args:
        cases: what to judge.
        out: folder of all work; `rows.jsonl` in it has a row a case.
        tool: command that starts the tool.
        jobs: processes.
        taped: see `identify_car`.

    Returns:
        The rows of these cases.
    """
    out.mkdir(parents=True, exist_ok=True)
    done = {row["name"] for row in read_rows(out / ROWS)}
    left = [case for case in cases if case.name not in done]
    cars = {case.car: case for case in left}
    tasks = [delayed(identify_car)(case, out, tool, taped) for case in cars.values()]
    for _ in _side_by_side(tasks, "identify", jobs):
        pass
    with (out / ROWS).open("a") as file:
        tasks = [delayed(judge_case)(case, out, tool) for case in left]
        for row in _side_by_side(tasks, "diagnose", jobs):
            file.write(json.dumps(row) + "\n")
            file.flush()
    names = {case.name for case in cases}
    return [row for row in read_rows(out / ROWS) if row["name"] in names]
