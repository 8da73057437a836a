"""Container, launch file, unit and manual page start, test and describe what the code has."""

import argparse
import configparser
import re
import shlex
import shutil
import subprocess
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from steerd.daemon.cli.commands.setup.completion import make_full_parser, make_manual
from steerd.daemon.cli.main import COMMANDS, run_cli

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def read_dockerfile():
    """Stages by name: their instructions as pairs, continued lines joined."""
    text = re.sub(r"\\\n\s*", "", (ROOT / "Dockerfile").read_text())
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    stages = {}
    name = ""
    for line in lines:
        word, rest = line.split(maxsplit=1)
        if word == "FROM":
            base, name = re.fullmatch(r"(\S+) AS (\w+)", rest).groups()
            stages[name] = [(word, base)]
        else:
            stages[name].append((word, rest))
    return stages


STAGES = read_dockerfile()


def steps(stage, word):
    return [rest for name, rest in STAGES[stage] if name == word]


def test_it_installs_as_the_makefile_does_and_tests_as_ci_does():
    apt, install = steps("built", "RUN")
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert install.split()[0] == "make"
    assert install.split()[1] in targets
    assert {"make", "git"} <= set(apt.partition("--no-install-recommends")[2].split())
    assert steps("test", "CMD") == ['["bash", ".ci/run"]']
    assert "make test" in (ROOT / ".ci" / "run").read_text()


def test_it_starts_the_console_script_and_stops_as_the_unit_does():
    assert steps("car", "ENTRYPOINT") == [f'["{next(iter(PROJECT["scripts"]))}"]']
    assert steps("car", "STOPSIGNAL") == ["SIGTERM"]
    (path,) = (rest for rest in steps("built", "ENV") if rest.startswith("PATH="))
    assert path == f"PATH={steps('built', 'WORKDIR')[0]}/.venv/bin:$PATH"


OPTIONS = [
    "--port", "/dev/vesc", "--mocap", "natnet://10.0.0.2/car?up=y&unicast=1", "--speed", "0.5",
    "--record", "/data/a drive <1>.mcap",
]  # fmt: skip


def test_launch_file_and_unit_start_the_same_command_line(capsys):
    assert run_cli(["service", "launch", *OPTIONS]) == 0
    executable = ET.fromstring(capsys.readouterr().out).find("executable")
    assert run_cli(["service", "print", *OPTIONS]) == 0
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.read_string(capsys.readouterr().out)
    service = unit["Service"]
    command = shlex.split(executable.attrib["cmd"])
    assert command == shlex.split(service["ExecStart"])
    assert command[1:4] == ["-m", "steerd", "run"]
    assert sorted(command[4:]) == sorted(OPTIONS)
    assert executable.attrib["sigterm_timeout"] == service["TimeoutStopSec"]


def test_a_launch_file_substitutes_nothing(capsys):
    assert run_cli(["service", "launch", *OPTIONS[:-1], "/data/$(env HOME).mcap"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "cannot be written in a launch file" in said.err


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
    done = subprocess.run(
        ["man", "--warnings", "-l", str(path)],
        capture_output=True,
        text=True,
        check=True,
        env={"LANG": "C.UTF-8", "MANWIDTH": "80", "PATH": "/usr/bin:/bin"},
    )
    assert done.stderr == ""
    assert "teleop" in done.stdout
