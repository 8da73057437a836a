"""Virtual time: the whole loop with every protocol byte, against real time.

CPU seconds, one process, unless said: recorded and not, by loop rate and by physics step; then
many seeds in as many processes as there are cores (wall time).
"""

import json
import multiprocessing as mp
import os
import sys
import tempfile
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from benchmarks.timing import python_unit, timed
from steerd.daemon.assembly.build import RunPlan, make_plan, make_world_config
from steerd.daemon.ipc.pipe_records import Sink
from steerd.daemon.offline.fast import make_recording
from steerd.daemon.offline.virtual import VirtualRun, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.sim_hw.world import World

BEGIN_NS, SECONDS, SEEDS = 2_000_000_000, 8.0, 100
SEED_S = 2.0
STEPS_MS = (1, 2, 5)
RATES = (100, 200)


@lru_cache
def plan_of(rate: int) -> RunPlan:
    """The drive; its controller is designed once."""
    return make_plan(
        RunOptions(
            car_file="", simulated=True, auto_arm=True, path="figure8", speed=1.5,
            duration_s=60.0, rate_hz=float(rate),
        )
    )  # fmt: skip


def make_run(rate: int, step_ms: int, record: Path | None, seed: int = 0) -> VirtualRun:
    plan = plan_of(rate)
    plan = replace(plan, options=replace(plan.options, seed=seed))
    world = World(replace(make_world_config(plan), step_ns=step_ms * 1_000_000))
    sinks: tuple[Sink, ...] = ()
    if record is not None:
        recording, board = make_recording(plan, record), Dashboard("")

        def sink(records: Any, t_ns: int) -> None:
            for each in records:
                recording.add(each)
                board.take(each)

        sinks = (sink,)
    return make_virtual_run(plan, sinks, world)


def until(run: VirtualRun, t_ns: float) -> None:
    while run.t_ns < t_ns:
        run.step()


def speed(rate: int, step_ms: int, record: Path | None = None) -> list[float]:
    """Simulated seconds per CPU second, of several stretches of a drive."""
    run, found = make_run(rate, step_ms, record), []
    until(run, BEGIN_NS)
    for part in range(1, 5):
        began = time.process_time()
        until(run, BEGIN_NS + part * SECONDS / 4 * 1e9)
        found.append(SECONDS / 4 / (time.process_time() - began))
    return sorted(round(value, 2) for value in found)


def calls_per_tick() -> float:
    """Calls of functions, Python's and C's, in a tick of a plain drive."""
    run, count, ticks = make_run(100, 2, None), 0, 100
    until(run, BEGIN_NS)

    def note(frame: Any, event: str, arg: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(note)
    for _ in range(ticks):
        run.step()
    sys.setprofile(None)
    return count / ticks


def one_seed(seed: int) -> float:
    """Drive with a seed; simulated seconds."""
    run = make_run(100, 2, None, seed)
    until(run, SEED_S * 1e9)
    return run.t_ns / 1e9


def many_seeds(workers: int, count: int) -> dict[str, float]:
    with mp.get_context("fork").Pool(workers) as pool:
        pool.map(one_seed, range(workers))
        began = time.perf_counter()
        driven = sum(pool.map(one_seed, range(count)))
        wall = time.perf_counter() - began
    return {"workers": workers, "seeds": count, "wall_s": round(wall, 2),
            "times_real": round(driven / wall, 1)}  # fmt: skip


def in_units() -> dict[str, float]:
    """A simulated second, recorded, in units of a fixed piece of pure Python: turn by turn."""
    units, seconds = [], []
    with tempfile.TemporaryDirectory() as folder:
        run = make_run(100, 2, Path(folder) / "drive.mcap")
        until(run, BEGIN_NS)
        for part in range(1, 9):
            units.append(timed(python_unit, repeats=3).median)
            began = time.process_time()
            until(run, BEGIN_NS + part * 1e9)
            seconds.append(time.process_time() - began)
    ratios = sorted(s / u for s, u in zip(seconds, units, strict=True))
    return {"median": ratios[4], "low": ratios[0], "high": ratios[-1],
            "unit_ms": 1e3 * sorted(units)[4]}  # fmt: skip


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        recorded = speed(100, 2, Path(folder) / "drive.mcap")
    cores = os.cpu_count() or 1
    found = {
        "calls": calls_per_tick(),
        "units": in_units(),
        "loop_hz": {str(rate): speed(rate, 2) for rate in RATES},
        "recorded": recorded,
        "physics_ms": {str(step): speed(100, step) for step in STEPS_MS},
        "seeds": [many_seeds(1, SEEDS // 10), many_seeds(cores, SEEDS)],
    }
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
