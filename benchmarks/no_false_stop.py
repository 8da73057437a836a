"""No false stop: hours of nominal driving with 5 % mocap loss and a 50 ms gap every second.

    python -m benchmarks.no_false_stop --hours 10
    python -m benchmarks.no_false_stop --hours 10 --off 0.2

Virtual time, seeds in parallel. Each drive is a figure-eight or a circle or a line;
each ends with its own planned stop, and anything else counts as a false stop. `--off` draws a car
for each drive, every parameter off its car file by up to this share.
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from joblib import Parallel, delayed

from steerd.car_model.car_file import default_car_path
from steerd.car_model.params import Car
from steerd.daemon.assembly.build import make_plan, make_world_config
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.settings.config import Settings, load_settings
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World

DRIVES = (("figure8", 1.0), ("figure8", 2.0), ("circle:radius=2", 1.5), ("line", 2.5))
WIDE = (
    ("figure8:radius=2.2", 1.0), ("figure8:radius=2.2", 2.0), ("circle:radius=2.2", 1.5),
    ("line", 2.5),
)  # fmt: skip
"""Bends that every drawn car can take: a fifth longer, its wheels turned a fifth less."""


class Drive(NamedTuple):
    """What became of one drive."""

    seed: int
    path: str
    driven_s: float
    stopped: str


def draw_car(car: Car[float], off: float, seed: int) -> Car[float]:
    """A car whose every parameter is off by up to this share, but for its gearing.

    Wheels that report another speed than the car has are not driven: W5 stops them in the launch
    window.
    """
    rng = np.random.default_rng(seed)
    drawn = Car(*(value * (1.0 + off * rng.uniform(-1.0, 1.0)) for value in car))
    return drawn._replace(speed_gain=car.speed_gain)


def load_identified(speed: float) -> Settings:
    """The default car file as if all of it had been identified: the tightest bounds."""
    settings = load_settings(default_car_path(), speed)
    file = replace(settings.file, sd=dict.fromkeys(Car._fields, 0.0))
    return replace(settings, file=file)


def drive_once(seed: int, seconds: float, off: float = 0.0) -> Drive:
    drives = WIDE if off else DRIVES
    path, speed = drives[seed % len(drives)]
    options = RunOptions(
        car_file="", path=path, speed=speed, seed=seed, duration_s=seconds, auto_arm=True
    )
    plan = make_plan(options, load_identified(speed) if off else None)
    faults = (Fault("M17"), Fault("M18"))
    config = make_world_config(plan)
    drawn = draw_car(config.model.car, off, seed)
    config = replace(config, model=config.model._replace(car=drawn))
    run = make_virtual_run(plan, world=World(config, faults))
    driven, why = 0, ""

    def count(now) -> None:  # type: ignore[no-untyped-def]
        nonlocal driven, why
        supervisor = now.core.loop.supervisor
        driven += supervisor.state is SupervisorState.RUNNING
        if driven and not why and supervisor.state is not SupervisorState.RUNNING:
            why = f"{supervisor.state.name}: {supervisor.reason}"

    drive(run, count)
    loop = run.core.loop
    good = loop.ran and not loop.faulted and driven * plan.period_ns >= (seconds - 0.05) * 1e9
    stopped = "" if good else why or f"{loop.supervisor.state.name}: {loop.supervisor.reason}"
    return Drive(seed, path, driven * plan.period_ns * 1e-9, stopped)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=10.0, help="simulated hours of driving")
    parser.add_argument("--minutes", type=float, default=2.0, help="of one drive")
    parser.add_argument("--seed", type=int, default=0, help="of the first drive")
    parser.add_argument("--off", type=float, default=0.0, help="share that the car file is off")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument(
        "--limit", type=float, default=1e9, metavar="S", help="stop after S seconds"
    )
    args = parser.parse_args()
    count = max(1, round(args.hours * 60.0 / args.minutes))
    began, driven, false = time.perf_counter(), 0.0, 0
    jobs = (delayed(drive_once)(args.seed + k, args.minutes * 60.0, args.off) for k in range(count))
    parallel = Parallel(n_jobs=args.jobs, return_as="generator", pre_dispatch="all", batch_size=1)
    for done in parallel(jobs):
        driven += done.driven_s
        if done.stopped:
            false += 1
            print(f"FALSE STOP seed {done.seed} {done.path} {done.driven_s:.1f} s: {done.stopped}")
        took = time.perf_counter() - began
        print(f"{driven / 3600:.3f} h driven in {took:.0f} s, {false} false stops", flush=True)
        if took > args.limit:
            os._exit(1 if false else 0)
    return 1 if false else 0


if __name__ == "__main__":
    sys.exit(main())
