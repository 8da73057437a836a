"""Do the standard errors of `sysid.fit` tell the truth? Pulls and errors over many seeded drives.

Run from the repository's root: `.venv/bin/python benchmarks/identify_coverage.py --seeds 100`.
The drives are the unit tests' own (tests/unit/sysid/conftest.py): 1 mm and 2 mrad of noise.
"""

import argparse
import importlib.util
import time
from pathlib import Path

import numpy as np

from car_model.model import Model
from car_model.params import DEFAULT_CAR
from sysid.fit import TYRES, fit


def _drives():
    path = Path(__file__).resolve().parent.parent / "tests" / "unit" / "sysid" / "conftest.py"
    spec = importlib.util.spec_from_file_location("sysid_drives", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    """Fit every seed's drive and print the spread of (estimate - truth) / standard error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    drives = _drives()
    truth = drives.TRUTH._asdict()
    pulls, errors, times, names = [], [], [], []
    for seed in range(args.seeds):
        run = drives.drive(Model(drives.TRUTH), args.seconds, seed)
        began = time.perf_counter()
        found = fit([run], Model(DEFAULT_CAR))
        times.append(time.perf_counter() - began)
        names = list(found.estimates)
        pulls.append([(e.value - truth[n]) / e.sd for n, e in found.estimates.items()])
        errors.append([100 * abs(found.estimates[n].value / truth[n] - 1) for n in TYRES])
    spread = np.sqrt(np.mean(np.square(pulls), axis=0))
    print(f"{args.seeds} drives of {args.seconds:g} s; fit {np.median(times):.2f} s (median)")
    for name, value in zip(names, spread, strict=True):
        print(f"  {name:12s} rms pull {value:.2f}")
    for name, value in zip(TYRES, np.median(errors, axis=0), strict=True):
        print(f"  {name:12s} median error {value:.3f} %")


if __name__ == "__main__":
    main()
