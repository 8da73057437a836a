"""Memory and time of `steerd identify` and `diagnose` by hours of driving.

    python -m benchmarks.perf_hours --hours 0.0167 0.167 1 10

Sessions of ten minutes or less, loops of the compiled simulator with mocap noise, imported like a
lab's own logs. Peak memory and processor time are the tool's own, as subprocesses.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.batch_drives import MAP, NOISE, STEP, make_car
from steerd.car_model.native.windows import (
    HeldCommands,
    make_kernels,
    make_window_blocks,
    march,
    view_by_window,
)
from steerd.daemon.imports.csv_log import import_csv
from steerd.daemon.imports.import_map import load_map

SESSION = 600.0
"""Length of a session, at most [s]."""


def make_log(seconds: float, seed: int) -> NDArray[np.float64]:
    """Rows of time, pose with noise, and commands of loops with a steering that swings."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(round(seconds / STEP))
    steer = rng.uniform(0.12, 0.16) + 0.1 * np.sin(rng.uniform(1.0, 2.0) * t)
    commands = np.column_stack([steer, 1.6 + 0.5 * np.sin(rng.uniform(0.4, 0.7) * t)])
    blocks = make_window_blocks(np.array([[0, len(t), 0]]), np.zeros(1))
    first = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    path = march(
        make_kernels(), np.array(make_car("hours", 0)), first, HeldCommands(commands, STEP),
        blocks, len(t),
    )  # fmt: skip
    poses = view_by_window(path, 1)[0, :-1, :3] + rng.normal(0.0, NOISE, (len(t), 3))
    return np.column_stack([t, poses, commands])


def make_sessions(folder: Path, hours: float) -> list[Path]:
    """So many hours of driving."""
    the_map, table = folder / "map.toml", folder / "log.csv"
    the_map.write_text(MAP.format(car="hours"))
    count = max(1, round(3600.0 * hours / SESSION))
    paths = []
    for number in range(count):
        rows = make_log(min(SESSION, 3600.0 * hours), number)
        np.savetxt(table, rows, fmt="%.6f", delimiter=",", comments="",
                   header="t,x,y,yaw,steer,speed")  # fmt: skip
        paths.append(folder / f"drive{number:02}.mcap")
        import_csv(table, load_map(the_map), paths[-1], lambda done: None)
    return paths


def run(folder: Path, *words: str) -> tuple[float, float]:
    """A command of the tool: peak memory [MB] and processor time [s]."""
    child = subprocess.Popen(
        [sys.executable, "-m", "steerd", *words], cwd=folder, stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"steerd {words[0]}: exit {os.waitstatus_to_exitcode(status)}")
    return used.ru_maxrss / 1024.0, used.ru_utime + used.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, nargs="*", default=(1 / 60, 1 / 6, 1.0, 10.0))
    args = parser.parse_args()
    for hours in args.hours:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            paths = [path.name for path in make_sessions(folder, hours)]
            learnt = run(folder, "identify", *paths, "-o", "car.toml")
            found = run(folder, "diagnose", *paths, "--base", "car.toml", "--no-closed-loop")
        row = {"hours": round(hours, 4), "sessions": len(paths)}
        for what, (memory, cpu) in (("identify", learnt), ("diagnose", found)):
            row |= {f"{what}_mb": round(memory), f"{what}_cpu_s": round(cpu, 1)}
        print(json.dumps(row), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
