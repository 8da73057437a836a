"""Mutation score of the safety code: output limits, state machine, watchdogs, guardian, codec.

    pip install --group bench
    python -m benchmarks.mutation
    python -m benchmarks.mutation "steerd.controller.limits*" --survivors
    python -m benchmarks.mutation --coverage

mutmut changes one operator, constant, argument or call at a time in a copy of the tree, and runs
the unit tests that reach it. A mutant that no test notices survives. Printed: killed and survived
by module, with `--survivors` each survivor's change. docs/results/safety.md explains them; a
person looked at each. `--coverage` measures the branches that the same tests take, in these modules
and in those that hold little but tables, and fails below 100 %.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = (
    "controller/limits.py", "daemon/process/guardian.py", "daemon/process/heartbeat.py",
    "daemon/loop/findings.py",
    "daemon/loop/following.py", "daemon/loop/follow_model.py",
    "daemon/loop/checks.py",
    "daemon/loop/lease.py", "daemon/loop/supervisor.py", "daemon/loop/watchdogs.py",
    "daemon/loop/watchdogs_pose.py",
    "steer_bus/codec.py",
)  # fmt: skip
TABLES = (
    "daemon/settings/thresholds.py", "daemon/loop/transitions.py", "steer_bus/lab.py",
)  # fmt: skip
TESTS = (
    "tests/unit/controller/test_limits.py", "tests/unit/daemon/loop/test_supervisor.py",
    "tests/unit/daemon/loop/test_watchdogs.py", "tests/unit/daemon/loop/test_watchdogs_pose.py",
    "tests/unit/daemon/settings/test_config.py", "tests/unit/daemon/loop/test_checks.py",
    "tests/unit/daemon/process/test_guardian.py", "tests/unit/daemon/loop/test_lease.py",
    "tests/unit/steer_bus/test_codec.py", "tests/unit/daemon/loop/test_following.py",
    "tests/unit/daemon/loop/test_findings.py",
)  # fmt: skip
MORE_TESTS = (
    "tests/unit/daemon/loop/test_core.py",
    "tests/unit/daemon/process/test_runner.py",
    "tests/unit/steer_bus/test_lab.py",
    "tests/unit/controller/test_lane_keeper.py",
)  # fmt: skip
NAME_WIDTH = 40
FOLDERS = ("steerd", "tests", "config")
# One test limits the guardian's length; a mutated file holds every mutant at once.
SELECTION = ("-m", "not realtime", "-k", "not stands_alone", "-p", "no:xdist")
SCORE_MIN = 0.9
"""Least share of killed mutants."""
KILLED = ("killed", "timeout", "segfault", "suspicious", "caught by type check")


def make_copy(folder: Path) -> None:
    """A copy of the tree with mutmut's settings in its pyproject.toml.

    The links in `steerd/` become folders, so that a module's path is its import name.
    """
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    settings = {
        "source_paths": [f"steerd/{module}" for module in MODULES],
        "also_copy": FOLDERS,
        "pytest_add_cli_args_test_selection": TESTS,
        "pytest_add_cli_args": (*SELECTION, "-p", "no:cacheprovider"),
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    text = (ROOT / "pyproject.toml").read_text() + "\n[tool.mutmut]\n" + "\n".join(lines) + "\n"
    (folder / "pyproject.toml").write_text(text)


def mutmut(folder: Path, *argv: str, timeout: float | None = None) -> str:
    """Run it there."""
    command = [sys.executable, "-m", "mutmut", *argv]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=timeout, check=False
    )
    return done.stdout + done.stderr


def read_results(folder: Path) -> dict[str, list[tuple[str, str]]]:
    """(mutant, what became of it) by module."""
    found = defaultdict(list)
    for name, fate in re.findall(
        r"^\s*(\S+__mutmut_\d+): (.+)$", mutmut(folder, "results", "--all", "true"), re.M
    ):
        found[re.split(r"\.x[_ǁ]", name)[0]].append((name, fate.strip()))
    return found


def show(folder: Path, name: str) -> str:
    """The changed lines of a mutant."""
    lines = mutmut(folder, "show", name).splitlines()
    return "\n".join(f"    {line}" for line in lines if re.match(r"[-+] ", line))


def report(folder: Path, *, survivors: bool) -> float:
    """Print the scores; the score over all that was tried [0 to 1]."""
    killed = tried = 0
    for module, mutants in sorted(read_results(folder).items()):
        fates = Counter("killed" if fate in KILLED else fate for _, fate in mutants)
        ran = fates["killed"] + fates["survived"] + fates["no tests"]
        if ran == 0:
            continue
        killed, tried = killed + fates["killed"], tried + ran
        print(f"{module:<{NAME_WIDTH}}{fates['killed']:5} of {ran:<5}{fates['killed'] / ran:7.1%}")
        for name, fate in mutants:
            if survivors and fate in ("survived", "no tests"):
                print(f"  {name.removeprefix(module + '.')}\n{show(folder, name)}")
    print(f"{'all':<{NAME_WIDTH}}{killed:5} of {tried:<5}{killed / max(tried, 1):7.1%}")
    return killed / max(tried, 1)


def measure_coverage(folder: str) -> int:
    """Branch coverage of all of these; 0 if it is whole."""
    env = os.environ | {"COVERAGE_FILE": f"{folder}/coverage"}
    modules = f"--include={','.join((*MODULES, *TABLES))}"
    coverage = [sys.executable, "-m", "coverage"]
    tests = ["-m", "pytest", "-q", *SELECTION[:2], "-p", "no:cacheprovider", *TESTS, *MORE_TESTS]
    ran = subprocess.run(
        [*coverage, "run", "--branch", modules, *tests], env=env, cwd=ROOT
    ).returncode
    report = [*coverage, "report", modules, "--show-missing", "--fail-under=100"]
    return ran or subprocess.run(report, env=env, cwd=ROOT).returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "mutants", nargs="*", help='such as "steerd.daemon.loop.checks*" (default: all)'
    )
    parser.add_argument("--survivors", action="store_true", help="show what survived")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="work there, and keep what is there already")
    parser.add_argument("--coverage", action="store_true", help="branch coverage instead")
    args = parser.parse_args()
    if args.coverage:
        with tempfile.TemporaryDirectory() as place:
            return measure_coverage(place)
    folder = args.folder or Path(tempfile.mkdtemp(prefix="mutation"))
    if not (folder / "pyproject.toml").exists():
        make_copy(folder)
    output = mutmut(folder, "run", "--max-children", str(args.jobs), *args.mutants)
    score = report(folder, survivors=args.survivors)
    if score == 0.0:
        print(output[-2000:], file=sys.stderr)
    if args.folder is None:
        shutil.rmtree(folder)
    return 0 if score >= SCORE_MIN else 1


if __name__ == "__main__":
    sys.exit(main())
