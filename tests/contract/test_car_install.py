"""A car's computer drives with what `make car` installs, without what identifies and draws."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CAR = PYPROJECT["dependency-groups"]["car"]
BROUGHT = {"matplotlib"}  # what a car needs only because python-control imports it
REST = sorted(
    each
    for each in set(PYPROJECT["project"]["dependencies"]) - set(CAR)
    if re.match(r"[\w-]+", each)[0] not in BROUGHT
)

BLOCKED = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in set(sys.argv[1].split(",")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
from steerd.daemon.cli.main import run_cli
sys.exit(run_cli(sys.argv[2:]))
"""


def package(requirement):
    return re.match(r"[\w-]+", requirement)[0]


def steerd(*words):
    """A command in a process that cannot import what a car's computer lacks."""
    absent = {package(each).replace("-", "_") for each in REST} | {"numba", "control"}
    argv = [sys.executable, "-c", BLOCKED, ",".join(absent), *map(str, words)]
    return subprocess.run(argv, capture_output=True, text=True, check=False, timeout=120)


def test_what_a_car_needs_is_a_part_of_what_steerd_needs():
    assert set(CAR) < set(PYPROJECT["project"]["dependencies"])
    lacking = {"torch", "argparse-manpage", "shtab"}
    assert lacking <= {package(each) for each in REST}


def test_the_lock_holds_the_car_and_a_hash_of_every_file():
    text = (ROOT / "car.lock").read_text()
    entries = re.findall(r"^([\w-]+)==\S+.*\n((?:    --hash=sha256:[0-9a-f]{64}.*\n)+)", text, re.M)
    assert len(entries) == len(re.findall("==[0-9]", text))
    assert {package(each).lower() for each in CAR} <= {name for name, _ in entries}
    assert not {package(each) for each in REST} & {name for name, _ in entries}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    words = ["run", "--sim", "--fast", "--speed", "1", "--duration", "2", "--record", path]
    done = steerd(*words)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return path


@pytest.mark.parametrize("name", ["info", "plot", "replay"])
def test_it_drives_and_shows_the_drive(drive, name):
    done = steerd(name, drive)
    assert done.returncode == 0, done.stderr


def test_what_it_cannot_do_it_says_in_a_line():
    done = steerd("completion", "bash")
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "steerd: `steerd completion` needs shtab" in done.stderr
    assert "pip install" in done.stderr
