"""The tool asked within this process: no start-up and no loading for each of hundreds of cases.

The same functions that `steerd identify` and `steerd diagnose` call, on the same files; a case's
time is the processor's. A car's base is identified once for all its cases. The set may be dealt out
to several processes; each takes every n-th car.
"""

import json
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

from benchmarks.blind_gap.opening import load_manifest
from benchmarks.blind_gap.verdicts import verdict_path
from car_model.car_file import CarFile, default_car_path, load_car
from sim_gap.diagnosis import Options, diagnose
from sim_gap.healthy import refine
from sim_gap.to_json import to_json
from sysid.dataset import Run, load_run
from sysid.fit import Options as FitOptions
from sysid.fit import fit

HORIZONS = (0.5, 2.0)
"""Windows of the identification [s]: over whole drives, disturbances bias it."""


def load_runs(out: Path, names: Sequence[str]) -> list[Run]:
    """Sessions of a set."""
    return [load_run(out / name) for name in names]


def identify(out: Path, names: Sequence[str]) -> CarFile:
    """A car from its healthy sessions, noise included."""
    runs = load_runs(out, names)
    start = load_car(default_car_path())
    found = fit(runs, start.model, options=FitOptions(horizons=HORIZONS))
    sd = {name: e.sd for name, e in found.estimates.items()}
    base = CarFile(start.path, start.name, found.model.car, sd=sd, sections=start.sections)
    return refine(base, runs)


def _ask(out: Path, verdicts: Path, row: Mapping[str, Any], base: CarFile) -> None:
    path = verdict_path(verdicts, row["case"])
    if path.exists():
        return
    began = process_time()
    try:
        runs, held = load_runs(out, row["runs"]), load_runs(out, row["held_out"])
        told = diagnose(runs, base, Options(held_out=held, horizons=False))
        path.write_text(json.dumps(to_json(told), allow_nan=False) + "\n")
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


def diagnose_part(out: Path, verdicts: Path, part: int = 0, parts: int = 1) -> None:
    """Diagnose every case of every `parts`-th car, from the car `part` on.

    Raises:
        OpeningError: there is no set.
    """
    manifest = load_manifest(out)
    verdicts.mkdir(parents=True, exist_ok=True)
    for row in manifest["cars"][part::parts]:
        cases = [case for case in manifest["cases"] if case["base"] == row["base"]]
        if all(verdict_path(verdicts, case["case"]).exists() for case in cases):
            continue
        base = identify(out, row["runs"])
        text = json.dumps(_encoded(base), indent=1)
        (verdicts / f"{row['base']}.base.json").write_text(text + "\n")
        for case in cases:
            _ask(out, verdicts, case, base)
