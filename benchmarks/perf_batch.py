"""`steerd batch identify` over a fleet: are hidden changes found, on which day, at which cost.

300 sessions of 10 cars over 30 days, three of which change on a day. A worker is killed on the way.
Then a part of them by one process and by two: wall time of each.
"""

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from benchmarks.batch_drives import DAY, FIRST, Hidden, make_fleet
from steerd.daemon.many.batch.changes import day_of
from steerd.daemon.many.batch.run import Batch, Question, make_job
from steerd.daemon.many.job import do_job
from steerd.daemon.many.units import Where

HIDDEN = (
    Hidden("car3", "steer_bias", 11, 0.02),
    Hidden("car6", "speed_gain", 17, -0.03),
    Hidden("car9", "c_sf", 22, -1.2),
)
QUESTION = Question("identify", {})
KILL_AT = 20
"""Sessions after which a worker is killed."""


def children() -> list[int]:
    """Worker processes of this one."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError, IndexError):
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid() and "loky" in (entry / "cmdline").read_text():
                found.append(int(entry.name))
    return found


def kill_one(done: float) -> None:
    if done == KILL_AT and (workers := children()):
        os.kill(workers[-1], signal.SIGKILL)


def timed(paths: Sequence[Path], jobs: int) -> float:
    """Wall seconds of a part of the fleet."""
    do_job(make_job(paths[: 2 * jobs], QUESTION), Where(jobs))  # workers and kernels are there
    began = time.perf_counter()
    do_job(make_job(paths, QUESTION), Where(jobs))
    return time.perf_counter() - began


def judge(found: Batch) -> dict[str, object]:
    """What was found of what was hidden."""
    first = {}
    for change in found.changes:
        first.setdefault(change.car, change)
    rows = []
    for each in HIDDEN:
        change, true = first.get(each.car), day_of(FIRST + each.day * DAY)
        days = None
        if change is not None:
            days = (date.fromisoformat(change.day) - date.fromisoformat(true)).days
        rows.append({"car": each.car, "parameter": each.parameter, "day": true,
                     "found": change and change.quantity, "days_off": days,
                     "sigma": change and round(change.sigmas, 1)})  # fmt: skip
    wrong = [c.car for c in first.values() if c.car not in {h.car for h in HIDDEN}]
    failed = sum(row["outcome"] != "done" for row in found.rows)
    return {"hidden": rows, "wrongly": wrong, "failed": failed}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=10)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--part", type=int, default=24, help="sessions by one and by two")
    args = parser.parse_args()
    load = round(os.getloadavg()[0], 1)
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        paths = make_fleet(Path(folder), args.cars, args.days, HIDDEN)
        made, began = time.perf_counter() - began, time.perf_counter()
        found = do_job(make_job(paths, QUESTION), Where(2), progress=kill_one)
        took = time.perf_counter() - began
        alone, together = timed(paths[: args.part], 1), timed(paths[: args.part], 2)
    print(json.dumps({
        "sessions": len(paths), "cars": args.cars, "made_s": round(made, 1),
        "identified_s": round(took, 1), **judge(found),
        "one_s": round(alone, 2), "two_s": round(together, 2),
        "load": load, "ratio": round(alone / together, 2),
    }))  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
