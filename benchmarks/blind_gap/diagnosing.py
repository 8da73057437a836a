"""Ask the tool: identify every car from its healthy sessions, then diagnose every case, blind."""

import shlex
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.progress import Progress

from benchmarks.blind_gap.unsealing import load_manifest
from benchmarks.blind_gap.verdicts import verdict_path

IDENTIFY = "steerd identify {runs} -o {base}"
DIAGNOSE = "steerd diagnose {runs} {held_out} --base {base} --held-out {held_names} --json"


def expand(template: str, values: Mapping[str, str | Sequence[str]]) -> list[str]:
    """Words of a command; a word that is one `{name}` of a list becomes all its entries.

    An empty list takes the option before it away as well.
    """
    words: list[str] = []
    for word in shlex.split(template):
        value = values.get(word.strip("{}")) if word.startswith("{") else None
        if value is None or isinstance(value, str):
            words.append(word.format(**{k: v for k, v in values.items() if isinstance(v, str)}))
            continue
        if not value and words and words[-1].startswith("--"):
            words.pop()
        words.extend(value)
    return words


def _run(words: Sequence[str], log: Path) -> tuple[str, float] | None:
    """Output and seconds of a command, None if it failed; its errors go to a file."""
    start = perf_counter()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    seconds = perf_counter() - start
    if done.returncode != 0:
        log.write_text(f"{shlex.join(words)}\nexit {done.returncode}\n{done.stderr}")
        return None
    return done.stdout, seconds


def _identify(out: Path, verdicts: Path, row: Mapping[str, Any], template: str) -> None:
    base = verdicts / f"{row['base']}.toml"
    if not base.exists():
        runs = [str(out / name) for name in row["runs"]]
        words = expand(template, {"runs": runs, "base": str(base)})
        _run(words, base.with_suffix(".error"))


def _diagnose(out: Path, verdicts: Path, row: Mapping[str, Any], template: str) -> None:
    path = verdict_path(verdicts, row["case"])
    if path.exists():
        return
    held = [str(out / name) for name in row["held_out"]]
    values: dict[str, str | Sequence[str]] = {
        "runs": [str(out / name) for name in row["runs"]],
        "held_out": held,
        "held_names": [",".join(held)] if held else [],
        "base": str(verdicts / f"{row['base']}.toml"),
        "verdict": str(path),
    }
    answer = _run(expand(template, values), path.with_suffix(".error"))
    if answer is not None:
        if not path.exists():
            path.write_text(answer[0])
        path.with_suffix(".time").write_text(f"{answer[1]:.3f}\n")


def diagnose_set(
    out: Path, verdicts: Path, identify: str = IDENTIFY, diagnose: str = DIAGNOSE
) -> None:
    """Run the tool on a set; what is there already is kept, so a broken run can be taken up again.

    Args:
        out: the set.
        verdicts: folder for car files, verdicts, run times and errors.
        identify: command with `{runs}` and `{base}`.
        diagnose: command with `{runs}`, `{held_out}`, `{held_names}` (comma-separated), `{base}`;
            the verdict is its output, or what it writes to `{verdict}`.

    Raises:
        OpeningError: there is no set.
    """
    manifest = load_manifest(out)
    verdicts.mkdir(parents=True, exist_ok=True)
    with Progress(transient=True) as progress:
        bar = progress.add_task("identify", total=len(manifest["cars"]))
        for row in manifest["cars"]:
            _identify(out, verdicts, row, identify)
            progress.advance(bar)
        bar = progress.add_task("diagnose", total=len(manifest["cases"]))
        for row in manifest["cases"]:
            _diagnose(out, verdicts, row, diagnose)
            progress.advance(bar)
