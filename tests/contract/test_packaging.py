"""What is installed and shipped: launch file, unit, manual, pages, a car's own dependencies."""

import argparse
import configparser
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET

import pytest

from steerd.daemon.cli.commands.completion import make_full_parser, make_manual
from steerd.daemon.cli.main import COMMANDS
from tests.contract.command_page import PAGE, make_page
from tests.contract.size import GOALS, ROOT, recorded, sizes

OPTIONS = [
    "--port", "/dev/vesc", "--mocap", "natnet://10.0.0.2/car?up=y&unicast=1", "--speed", "0.5",
    "--record", "/data/a drive <1>.mcap",
]  # fmt: skip


def test_launch_file_and_unit_start_the_same_command_line(cli):
    executable = ET.fromstring(cli("service", "launch", *OPTIONS).out).find("executable")
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.read_string(cli("service", "print", *OPTIONS).out)
    service = unit["Service"]
    command = shlex.split(executable.attrib["cmd"])
    assert command == shlex.split(service["ExecStart"])
    assert command[1:4] == ["-m", "steerd", "run"]
    assert sorted(command[4:]) == sorted(OPTIONS)
    assert executable.attrib["sigterm_timeout"] == service["TimeoutStopSec"]


def test_the_manual_page_has_every_command_and_option():
    page = make_manual(make_full_parser())
    assert page == make_manual(make_full_parser()), "no date"
    plain = page.replace("\\-", "-")
    children = next(a for a in make_full_parser()._actions if a.dest == "command").choices
    assert set(children) == set(COMMANDS)
    for name, child in children.items():
        assert f"'steerd {name}'" in plain, name
        shown = [a for a in child._actions[1:] if a.help != argparse.SUPPRESS]  # first is --help
        for action in shown:
            assert all(option in plain for option in action.option_strings), (name, action)


@pytest.mark.skipif(not shutil.which("man"), reason="no man on this machine")
def test_the_manual_page_is_set_without_a_warning(tmp_path):
    path = tmp_path / "steerd.1"
    path.write_text(make_manual(make_full_parser()))
    argv = ["man", "--warnings", "-l", str(path)]
    plain = {"LANG": "C.UTF-8", "MANWIDTH": "80", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(argv, capture_output=True, text=True, check=True, env=plain)
    assert done.stderr == ""
    assert "teleop" in done.stdout


# Pages repeat what the code says, and no room is larger than recorded.
def test_pages_hold_every_command_and_every_section_of_a_car_file():
    hint = "run python -m tests.contract.command_page"
    assert PAGE.read_text(encoding="utf-8") == make_page(), hint
    text = (ROOT / "docs" / "reference" / "car-file.md").read_text(encoding="utf-8")
    explained = set(re.findall(r"^\| `\[([a-z]+)\]`", text, re.MULTILINE))
    sections = tomllib.loads((ROOT / "config" / "f1tenth.toml").read_text(encoding="utf-8"))
    assert set(sections) <= explained


# No room grows.
def test_every_room_has_a_recorded_size_and_none_is_larger():
    assert set(recorded()) == set(GOALS)
    try:
        now = sizes()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout: what belongs to a room cannot be listed")
    larger = {r: (now[r], most) for r, most in recorded().items() if now[r] > most}
    assert not larger, f"(lines, recorded) {larger}: a change that adds lines takes as many away"


# A car's computer drives with what `make car` installs, without what identifies and draws.
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CAR = PYPROJECT["dependency-groups"]["car"]
BROUGHT = {"matplotlib"}  # what a car needs only because python-control imports it
MORE = set(PYPROJECT["project"]["dependencies"]) - set(CAR)
REST = sorted(each for each in MORE if re.match(r"[\w-]+", each)[0] not in BROUGHT)

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


def test_what_a_car_needs_is_a_part_and_locked_with_a_hash_of_every_file():
    assert set(CAR) < set(PYPROJECT["project"]["dependencies"])
    lacking = {"torch", "argparse-manpage", "shtab"}
    assert lacking <= {package(each) for each in REST}
    text = (ROOT / "car.lock").read_text()
    entries = re.findall(r"^([\w-]+)==\S+.*\n((?:    --hash=sha256:[0-9a-f]{64}.*\n)+)", text, re.M)
    assert len(entries) == len(re.findall("==[0-9]", text))
    assert {package(each).lower() for each in CAR} <= {name for name, _ in entries}
    assert not {package(each) for each in REST} & {name for name, _ in entries}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    words = ["run", "--sim", "--fast", "--speed", "1", "--duration", "2", "--record"]
    subprocess.run([sys.executable, "-m", "steerd", *words, f"{path}.first"], check=True)  # designs
    done = steerd(*words, path)
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
