"""No false stop: hours of nominal driving with 5 % mocap loss and a 50 ms gap every second.

    python benchmarks/no_false_stop.py --hours 10

Virtual time, seeds in parallel. Each drive is a figure-eight or a circle or a line;
each ends with its own planned stop, and anything else counts as a false stop.
"""

import argparse
import os
import sys
import time
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from joblib import Parallel, delayed

from steerd.daemon.assembly.build import make_plan, make_world_config
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World

DRIVES = (("figure8", 1.0), ("figure8", 2.0), ("circle:radius=2", 1.5), ("line", 2.5))


class Drive(NamedTuple):
    """What became of one drive."""

    seed: int
    path: str
    driven_s: float
    stopped: str


def drive_once(seed: int, seconds: float) -> Drive:
    path, speed = DRIVES[seed % len(DRIVES)]
    options = RunOptions(
        car_file="", path=path, speed=speed, seed=seed, duration_s=seconds, auto_arm=True
    )
    plan = make_plan(options)
    faults = (Fault("M17"), Fault("M18"))
    run = make_virtual_run(plan, world=World(make_world_config(plan), faults))
    driven = 0

    def count(now) -> None:  # type: ignore[no-untyped-def]
        nonlocal driven
        driven += now.core.loop.supervisor.state is SupervisorState.RUNNING

    drive(run, count)
    loop = run.core.loop
    good = loop.ran and not loop.faulted and driven * plan.period_ns >= (seconds - 0.05) * 1e9
    stopped = "" if good else f"{loop.supervisor.state.name}: {loop.supervisor.reason}"
    return Drive(seed, path, driven * plan.period_ns * 1e-9, stopped)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=10.0, help="simulated hours of driving")
    parser.add_argument("--minutes", type=float, default=2.0, help="of one drive")
    parser.add_argument("--seed", type=int, default=0, help="of the first drive")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument(
        "--limit", type=float, default=1e9, metavar="S", help="stop after S seconds"
    )
    args = parser.parse_args()
    count = max(1, round(args.hours * 60.0 / args.minutes))
    began, driven, false = time.perf_counter(), 0.0, 0
    jobs = (delayed(drive_once)(args.seed + k, args.minutes * 60.0) for k in range(count))
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
