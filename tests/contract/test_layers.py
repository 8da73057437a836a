"""The house as a whole: layers hold, the command is there, and `--help` answers at once."""

import importlib.metadata
import subprocess
import sys
import time
from pathlib import Path

from steerd.version import VERSION

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = Path(sys.executable).parent


def test_rooms_import_downwards_only() -> None:
    done = subprocess.run(
        [SCRIPTS / "lint-imports", "--no-cache"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


def test_the_console_script_is_ours() -> None:
    points = importlib.metadata.entry_points(group="console_scripts", name="steerd")
    assert {point.value for point in points} == {"steerd.daemon.cli.main:main"}
    done = subprocess.run(
        [SCRIPTS / "steerd", "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout == f"steerd {VERSION}\n"


def cpu_seconds(*argv: str) -> float:
    """The least processor time of five runs: what the command itself costs, whatever else runs."""
    costs = []
    for _ in range(5):
        before = time.clock_gettime_ns(time.CLOCK_MONOTONIC), children_ns()
        subprocess.run([sys.executable, *argv], cwd=ROOT, capture_output=True, check=True)
        costs.append(children_ns() - before[1])
    return min(costs) * 1e-9


def children_ns() -> int:
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round((used.ru_utime + used.ru_stime) * 1e9)


def test_help_costs_little_more_than_python_itself() -> None:
    """0.3 s on any machine that starts Python in 0.05 s: a ratio, so that a slow one may run it."""
    bare = cpu_seconds("-c", "pass")
    assert cpu_seconds("-m", "steerd", "--help") < max(6.0 * bare, 0.1)
