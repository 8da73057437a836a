"""Seconds of diagnosis for a minute of driving, by candidates and by jobs.

One minute in four drives of the default car whose steering comes 30 ms late, with mocap noise. The
effects looked at are cut to the first few of the library, the true one among them.
"""

import json
import os
import sys
import time
from typing import Any

import numpy as np

from benchmarks.identify import drive
from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.effects import EFFECTS
from steerd.car_model.native.windows import Kernels, make_kernels
from steerd.car_model.params import DEFAULT_CAR
from steerd.sim_gap.diagnosis import Case, GapOptions, diagnose
from steerd.sysid.data.dataset import Run, Signal, make_run

H, SECONDS, DRIVES, LATE = 0.01, 15.0, 4, 3
CANDIDATES = (4, 8, 16)


def make_drive(kernels: Kernels, number: int) -> Run:
    rng = np.random.default_rng(number)
    ticks = round(SECONDS / H)
    speed = np.repeat(rng.uniform(1.0, 2.5, ticks // 150 + 1), 150)[:ticks]
    steer = np.repeat(rng.uniform(-0.2, 0.2, ticks // 40 + 1), 40)[:ticks]
    late = np.concatenate([np.zeros(LATE), steer[:-LATE]])
    orders = np.column_stack([late, speed])
    states = drive(kernels, DEFAULT_CAR, orders, np.array([0.0, 0, 0, speed[0], 0, 0, 0]))
    t = H * np.arange(len(states))
    noise = rng.normal(0.0, 1.0, (len(t), 3)) * [7e-4, 7e-4, 2e-3]
    held = H * np.arange(ticks)
    seen = Signal(t, states[:, :3] + noise)
    return make_run(f"drive {number}", Signal(held, steer), Signal(held, speed), seen, h=H)


def measure(runs: list[Run], count: int, jobs: int) -> dict[str, Any]:
    names = ["steer_delay", *(name for name in EFFECTS if name != "steer_delay")][:count]
    cpu, wall = time.process_time(), time.perf_counter()
    diagnosis = diagnose(
        Case(runs, load_car(default_car_path()), GapOptions(only=names, pairs=False))
    )
    return {
        "candidates": len(names),
        "jobs": jobs,
        "cpu_s": round(time.process_time() - cpu, 2),
        "wall_s": round(time.perf_counter() - wall, 2),
        "named": diagnosis.causes[0].effect if diagnosis.causes else "",
        "verdict": diagnosis.verdict,
    }


def main() -> int:
    kernels = make_kernels()
    runs = [make_drive(kernels, number) for number in range(DRIVES)]
    measure(runs, 2, 1)  # compiled kernels in memory
    plans = [(count, 1) for count in CANDIDATES] + [(CANDIDATES[-1], os.cpu_count() or 1)]
    found = [measure(runs, *plan) for plan in plans]
    print(json.dumps({"driven_s": DRIVES * SECONDS, "rows": found}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
