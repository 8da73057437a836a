"""Does every drive and start lead to the car, and are the standard errors right?

python -m benchmarks.identify_coverage --seeds 100               # eleven parameters, three starts
python -m benchmarks.identify_coverage --saturation --seeds 10   # a tyre that the model lacks

Each seed is a mixed drive of 60 s at 1 to 3 m/s (tests/unit/sysid/conftest.py: simulated by
car_model, 1 mm and 2 mrad of pose noise) and three fits: from the default car, from a random car of
U(0.1, 0.35) m x U(2, 10), and from one of five bad ones. `--first` and `--seeds` cut it in parts;
what was run gathers in `--gather FILE.npz`, and the table is of all that is there.
"""

import argparse
import importlib.util
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from steerd.car_model.effects import find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import make_blocks
from steerd.sysid.estimation.outcome import Fit, fit_of_plain
from steerd.sysid.inference.plain_car import DEFAULT_FREE, Asked, search_plain
from steerd.sysid.paper import NAMES as TYRES

BAD = (
    (0.324, 0.324, 7.0, 7.0), (0.1, 0.35, 2.0, 10.0), (0.35, 0.1, 10.0, 2.0), (0.1, 0.1, 2.0, 2.0),
    (0.35, 0.35, 10.0, 10.0),
)  # fmt: skip
"""Starts far from any car: lf, lr, c_sf, c_sr."""
STARTS = ("default", "random", "bad")
LATERAL = (1.0, 2.0, 3.0, 4.0, 5.0)
"""Greatest lateral accelerations of drives on a saturating tyre [m/s^2]."""


def _drives() -> ModuleType:
    path = Path(__file__).resolve().parent.parent / "tests" / "unit" / "sysid" / "conftest.py"
    spec = importlib.util.spec_from_file_location("sysid_drives", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _start(kind: str, seed: int) -> Model[float]:
    rng = np.random.default_rng([3, seed])
    drawn = [*rng.uniform(0.1, 0.35, 2), *rng.uniform(2.0, 10.0, 2)]
    four = {"default": None, "random": drawn, "bad": BAD[seed % len(BAD)]}[kind]
    moved = dict(zip(TYRES, map(float, four), strict=True)) if four is not None else {}
    return Model(DEFAULT_CAR._replace(**moved))


def fit(run: Run, start: Model[float], wheelbase: float | None = None) -> Fit:
    """As `learn` does where the plain car explains the drives."""
    blocks, asked = make_blocks([run]), Asked(Model(DEFAULT_CAR), DEFAULT_FREE, wheelbase)
    rough = search_plain(blocks, asked._replace(model=start))
    found = rough and search_plain(blocks, asked, rough)
    if not found:
        raise FloatingPointError("the simulation diverges")
    return fit_of_plain(found, blocks, asked, ())


def _row(found: Fit, seconds: float) -> list[float]:
    pairs = [(found.estimates[n].value, found.estimates[n].sd) for n in DEFAULT_FREE]
    return [seconds, found.converged, *np.ravel(pairs).tolist()]


def cover(drives: ModuleType, seeds: range, seconds: float) -> np.ndarray:
    """(seeds, starts, 2 + 2 * 11): CPU seconds, convergence, values with errors."""
    rows = []
    for seed in seeds:
        run = drives.drive(Model(drives.TRUTH), seconds, seed)
        found = []
        for kind in STARTS:
            began = time.process_time()
            fitted = fit(run, _start(kind, seed))
            found.append(_row(fitted, time.process_time() - began))
        rows.append(found)
    return np.array(rows)


def say(rows: np.ndarray, truth: dict[str, float]) -> None:
    """The tables."""
    true = np.array([truth[name] for name in DEFAULT_FREE])
    value, sd = rows[..., 2::2], rows[..., 3::2]
    pull = (value - true) / sd
    apart = np.abs(value - value[:, :1]) / sd[:, :1]
    print(f"{len(rows)} drives, {rows.shape[1]} starts each")
    for i, kind in enumerate(STARTS):
        done = int(rows[:, i, 1].sum())
        same = int((apart[:, i].max(axis=1) < 0.1).sum())
        cost = f"{np.median(rows[:, i, 0]):.2f} s CPU (median)"
        print(f"  {kind:8s} converged {done}, same car {same}; {cost}")
    print(f"{'':14s}{'spread/CRB':>11s}{'mean pull':>11s}{'|pull|<2':>10s}{'median error':>14s}")
    # each drive has its own bound: the spread is that of errors in units of it
    spread = np.sqrt(np.mean(pull[:, 0] ** 2, axis=0))
    for k, name in enumerate(DEFAULT_FREE):
        off = np.median(np.abs(value[:, 0, k] - true[k]))
        size = f"{100 * off / abs(true[k]):.3f} %"
        inside = np.mean(np.abs(pull[:, 0, k]) < 2.0)
        print(
            f"  {name:12s}{spread[k]:>11.2f}{pull[:, 0, k].mean():>11.2f}{inside:>10.0%}{size:>14s}"
        )
    print(f"  all normalised errors: standard deviation {pull[:, 0].std():.3f}")


def saturate(drives: ModuleType, seeds: range, seconds: float) -> None:
    """What the linear tyre makes of a saturating one: errors by lateral acceleration."""
    effect = find_effect("tyre_saturation")
    plant = Model(drives.TRUTH, (effect,), ((1.0, *effect.nulls[1:]),))
    names = (*TYRES, "inertia_z", "steer_gain")
    base = drives.TRUTH.lf + drives.TRUTH.lr
    print("wheelbase given; medians over the drives")
    print("lateral [m/s2]  " + "".join(f"{name:>12s}" for name in names) + "   residual/noise")
    for lateral in LATERAL:
        off, misfit = [], []
        for seed in seeds:
            commands = drives.mixed_commands(seconds, seed, lateral)
            first = np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
            run = drives.simulate_run(plant, commands, first, seed)
            found = fit(run, Model(DEFAULT_CAR), base)
            true = drives.TRUTH._asdict()
            off.append([100.0 * (found.estimates[n].value / true[n] - 1.0) for n in names])
            misfit.append(found.misfit["position"])
        cells = "".join(f"{v:>10.1f} %" for v in np.median(off, axis=0))
        print(f"{lateral:>14.1f}  {cells}   {np.median(misfit):.2f}", flush=True)


def _gathered(path: Path | None, rows: np.ndarray, first: int) -> np.ndarray:
    if path is None:
        return rows
    kept: dict[str, Any] = dict(np.load(path)) if path.exists() else {}
    kept |= {f"{first + i:05d}": row for i, row in enumerate(rows)}
    np.savez(path, **kept)
    return np.array([kept[key] for key in sorted(kept)])


def main() -> None:
    """Drive, fit, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--gather", type=Path, metavar="FILE.npz")
    parser.add_argument("--saturation", action="store_true")
    args = parser.parse_args()
    drives, seeds = _drives(), range(args.first, args.first + args.seeds)
    if args.saturation:
        saturate(drives, seeds, args.seconds)
        return
    rows = _gathered(args.gather, cover(drives, seeds, args.seconds), args.first)
    say(rows, drives.TRUTH._asdict())


if __name__ == "__main__":
    main()
