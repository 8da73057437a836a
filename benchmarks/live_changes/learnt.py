"""What the learner knows of a car after a minute, beside `steerd identify` on the same session.

python -m benchmarks.live_changes.learnt --cars 20 rows.jsonl

A minute of figure-eights of the blind test's four-wheel car, as a table, imported, learnt and
identified by the commands of the README from the same car file (F1TENTH's published figures).
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_gap.car import PlantCar, make_car, wheel_inertia
from benchmarks.foreign_cars.log import MAP, Log, write_csv
from benchmarks.live_changes.plant import drive
from steerd.car_model.car_file import default_car_path, load_car
from steerd.sim_gap.online.samples import Ordered, PoseSeen, Rolled

SECONDS = 60.0
FIRST_SEED = 2000
"""Cars that no other figure was taken from."""
WITHIN = 2.0
"""Combined standard deviations that the two may differ by."""

Json = dict[str, Any]


def make_log(car: PlantCar, rng: np.random.Generator) -> Log:
    """A minute of it as a lab would log it."""
    samples = list(drive(car, SECONDS, rng))
    seen = [s for s in samples if isinstance(s, PoseSeen)]
    ordered = [s for s in samples if isinstance(s, Ordered)]
    rolled = [s for s in samples if isinstance(s, Rolled)]
    return Log(
        np.array([s.t for s in seen]),
        np.array([s[1:4] for s in seen]),
        np.array([s[1:3] for s in ordered]),
        np.array([s[1] for s in rolled]),
    )


def truth_of(car: PlantCar) -> dict[str, float]:
    """The plant's own numbers, where they mean what the car file's mean."""
    mu = load_car(default_car_path()).model.car.mu
    return {
        "c_sf": car.mu * car.stiff_front / mu, "c_sr": car.mu * car.stiff_rear / mu,
        "lf": car.lf, "lr": car.lr, "inertia_z": car.inertia_z + wheel_inertia(car),
        "steer_gain": car.steer_gain, "steer_bias": car.steer_bias,
        "steer_delay": car.steer_delay, "speed_gain": car.speed_gain,
    }  # fmt: skip


def compare(seed: int) -> Json:
    """One car: what both say, and what is true."""
    car = _car(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "map.toml").write_text(MAP)
        write_csv(folder / "log.csv", make_log(car, np.random.default_rng([seed, 2])))
        _tool(folder, "import", "csv", "log.csv", "--map", "map.toml", "-o", "drive.mcap")
        base = str(default_car_path())
        learnt = json.loads(_tool(folder, "learn", "drive.mcap", "--base", base, "--json"))
        words = ("--car", base, "-o", "car.toml", "--json", "car.json")
        _tool(folder, "identify", "drive.mcap", *words)
        identified = json.loads((folder / "car.json").read_text())["parameters"]
    return {"seed": seed, "learnt": learnt, "identified": identified}


def _car(seed: int) -> PlantCar:
    return make_car(np.random.default_rng([seed, 1]))


def _tool(folder: Path, *words: str) -> str:
    line = [sys.executable, "-m", "steerd", *words]
    return subprocess.run(line, cwd=folder, capture_output=True, text=True, check=True).stdout


def apart(row: Json) -> dict[str, float]:
    """How far the two are from each other, in combined standard deviations, by parameter."""
    found = {}
    for name, mine in model_of(row).items():
        other = row["identified"].get(name)
        if other is not None and other["sd"]:
            combined = float(np.hypot(mine["sd"], other["sd"]))
            found[name] = (mine["value"] - other["value"]) / combined
    return found


def model_of(row: Json) -> Mapping[str, Json]:
    """The learner's last values."""
    found: Mapping[str, Json] = row["learnt"]["model"]
    return found


def describe(rows: Sequence[Json]) -> str:
    """By parameter: how many within `WITHIN`, and the spread of differences and errors."""
    lines = ["| parameter | within 2 | spread of differences | of learnt errors | of identified |"]
    lines.append("|---" * 5 + "|")
    for name in dict.fromkeys(name for row in rows for name in apart(row)):
        found = np.array([d[name] for row in rows if name in (d := apart(row))])
        within = f"{int((np.abs(found) <= WITHIN).sum())} of {len(found)}"
        learnt = _spread([_error(model_of(row), row, name) for row in rows])
        identified = _spread([_error(row["identified"], row, name) for row in rows])
        lines.append(f"| {name} | {within} | {_spread(found)} | {learnt} | {identified} |")
    every = np.concatenate([list(apart(row).values()) for row in rows])
    share = float((np.abs(every) <= WITHIN).mean())
    lines += ["", f"Within {WITHIN:g} of all {len(every)}: {100 * share:.1f} %."]
    return "\n".join(lines)


def _error(found: Mapping[str, Json], row: Json, name: str) -> float:
    """Of an estimate, in its standard deviations; NaN where nothing is known to be true."""
    truth, entry = truth_of(_car(row["seed"])).get(name), found.get(name)
    if truth is None or entry is None or not entry["sd"]:
        return np.nan
    return float((entry["value"] - truth) / entry["sd"])


def _spread(values: Sequence[float] | NDArray[np.float64]) -> str:
    known = np.array([value for value in values if np.isfinite(value)])
    return f"{np.sqrt(np.mean(known**2)):.2f}" if known.size else "-"


def main() -> None:
    """Drive what has no row yet, and print the table of all rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--cars", type=int, default=20)
    args = parser.parse_args()
    args.rows.touch()
    rows = [json.loads(line) for line in args.rows.read_text().splitlines()]
    done = {row["seed"] for row in rows}
    for seed in range(FIRST_SEED, FIRST_SEED + args.cars):
        if seed not in done:
            rows.append(compare(seed))
            with args.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print(describe(rows))


if __name__ == "__main__":
    main()
