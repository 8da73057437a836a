"""The tool asked within this process: no start-up and no loading for each of hundreds of cases.

The same functions that `steerd identify` and `steerd diagnose` call, on the same files; a case's
time is the processor's. A car's base is identified once for all its cases. Several processes may
work on one set: each car and each case is claimed by a file before it is worked on. After a run
that was broken off, remove `*.claim` and start again: what has a verdict is kept.
"""

import json
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

from benchmarks.blind_gap.unsealing import load_manifest
from benchmarks.blind_gap.verdicts import verdict_path
from steerd.car_model.car_file import CarFile, default_car_path, load_car
from steerd.car_model.effects import EFFECTS
from steerd.car_model.params import Car
from steerd.sim_gap.diagnosis import Options, diagnose
from steerd.sim_gap.report.to_json import to_json
from steerd.sysid.data.dataset import Run, load_run
from steerd.sysid.inference.car_posterior import refine


def load_runs(out: Path, names: Sequence[str]) -> list[Run]:
    """Sessions of a set."""
    return [load_run(out / name) for name in names]


def identify(out: Path, names: Sequence[str]) -> CarFile:
    """A car from its healthy sessions, noise included."""
    return refine(load_car(default_car_path()), load_runs(out, names))


def _claimed(path: Path) -> bool:
    """Whether this process is the first to work on something."""
    try:
        path.with_suffix(".claim").touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def _ask(out: Path, verdicts: Path, row: Mapping[str, Any], base: CarFile) -> None:
    path = verdict_path(verdicts, row["case"])
    if path.exists() or not _claimed(path):
        return
    began = process_time()
    try:
        runs, held = load_runs(out, row["runs"]), load_runs(out, row["held_out"])
        diagnosis = diagnose(runs, base, Options(held_out=held, horizons=False))
        path.write_text(json.dumps(to_json(diagnosis), allow_nan=False) + "\n")
        path.with_suffix(".time").write_text(f"{process_time() - began:.3f}\n")
    except Exception:  # one case must not end the run; it counts as a failure
        path.with_suffix(".error").write_text(traceback.format_exc())


def _encoded(base: CarFile) -> dict[str, Any]:
    """A base car for whoever wants to see what was taken for healthy."""
    return {
        "car": base.car._asdict(),
        "sd": dict(base.sd),
        "noise": dict(base.sections["noise"]),
        "effects": {e.name: v for e, v in zip(base.effects, base.values, strict=True)},
    }


def _decoded(text: str) -> CarFile:
    """The reverse of `_encoded`."""
    given = json.loads(text)
    start, own = load_car(default_car_path()), given["effects"]
    return replace(
        start,
        car=Car(**given["car"]),
        effects=tuple(EFFECTS[name] for name in own),
        values=tuple(tuple(v) for v in own.values()),
        sd=given["sd"],
        source={},
        sections={**start.sections, "noise": given["noise"]},
        text="",
    )


def _base(out: Path, verdicts: Path, row: Mapping[str, Any]) -> CarFile | None:
    """The car's base: kept from before, or identified; None while another process is at it."""
    kept = verdicts / f"{row['base']}.base.json"
    if not kept.exists():
        if not _claimed(kept):
            return None
        text = json.dumps(_encoded(identify(out, row["runs"])), indent=1)
        part = kept.with_suffix(".part")
        part.write_text(text + "\n")
        part.replace(kept)
    return _decoded(kept.read_text())


def diagnose_inside(out: Path, verdicts: Path) -> None:
    """Diagnose every case of a set that no other process has claimed.

    Raises:
        OpeningError: there is no set.
    """
    manifest = load_manifest(out)
    verdicts.mkdir(parents=True, exist_ok=True)
    left = list(manifest["cars"])
    for row in [*left, *left]:
        base = _base(out, verdicts, row)
        for case in manifest["cases"]:
            if base is not None and case["base"] == row["base"]:
                _ask(out, verdicts, case, base)
