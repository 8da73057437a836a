"""What a recorded simulated second costs, as a ratio to what it cost at another commit.

    python -m benchmarks.perf_ratio [--since COMMIT] [--seconds N]

Two processes with one interpreter, one on each tree, drive a simulated second turn by turn: CPU
time, so that a busy machine slows both alike. The other tree is a worktree of the clone's history,
made for this and taken away again.
"""

import argparse
import gc
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SINCE = "21d99ff"
"""The commit whose cost a simulated second is a part of."""
_GC_THRESHOLD = 20_000
"""As a drive in virtual time sets it."""


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """A tree of another commit, while it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(
            ["git", "worktree", "add", "--quiet", "--detach", str(tree), commit],
            cwd=ROOT, check=True,
        )  # fmt: skip
        known = tree / "steerd-0.dist-info"  # what the package was called then
        known.mkdir()
        (known / "METADATA").write_text("Metadata-Version: 2.1\nName: steerd\nVersion: 0\n")
        try:
            yield tree
        finally:
            subprocess.run(
                ["git", "worktree", "remove", "--force", str(tree)], cwd=ROOT, check=True
            )


def begin(tree: Path) -> subprocess.Popen[str]:
    """A process that drives with a tree's packages, a second for each line that it is given."""
    paths = os.pathsep.join((str(tree), str(tree / "benchmarks")))
    return subprocess.Popen(
        [sys.executable, str(Path(__file__).resolve()), "--drive"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tree,
        env={**os.environ, "PYTHONSAFEPATH": "1", "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip


def drive_by_turns() -> None:
    """What such a process does: print the CPU seconds of each simulated one."""
    virtual = importlib.import_module("perf_virtual")
    gc.set_threshold(_GC_THRESHOLD)
    with tempfile.TemporaryDirectory() as folder:
        run = virtual.make_run(100, 2, Path(folder) / "drive.mcap")
        virtual.until(run, virtual.BEGIN_NS)
        for _ in sys.stdin:
            end_ns, began = run.t_ns + 1e9, time.process_time()
            virtual.until(run, end_ns)
            print(time.process_time() - began, flush=True)


def one_second(process: subprocess.Popen[str]) -> float:
    """CPU seconds of its next simulated second.

    Raises:
        RuntimeError: it has ended.
    """
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    said = process.stdout.readline()
    if not said:
        raise RuntimeError(f"{process.args!r} ended")
    return float(said)


def compare(old: Path, new: Path, seconds: int) -> dict[str, float]:
    """Ratios of new to old, and the median cost of each [ms]."""
    drives = [begin(tree) for tree in (old, new)]
    try:
        pairs = [[one_second(drive) for drive in drives] for _ in range(seconds + 1)][1:]
    finally:
        for drive in drives:
            drive.communicate()
    ratios = sorted(after / before for before, after in pairs)
    before, after = (1e3 * sorted(column)[seconds // 2] for column in zip(*pairs, strict=True))
    found = {"median": ratios[seconds // 2], "low": ratios[0], "high": ratios[-1],
             "before_ms": before, "after_ms": after}  # fmt: skip
    return {name: round(value, 3) for name, value in found.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--since", default=SINCE, help="commit to compare with")
    parser.add_argument("--seconds", type=int, default=12, help="simulated seconds of each")
    parser.add_argument("--drive", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.drive:
        drive_by_turns()
        return 0
    with worktree(args.since) as old:
        print(json.dumps({"since": args.since, **compare(old, ROOT, args.seconds)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
