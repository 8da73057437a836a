"""Launch file, unit and manual page start and describe what the code has."""

import argparse
import configparser
import shlex
import shutil
import subprocess
import xml.etree.ElementTree as ET

import pytest

from steerd.daemon.cli.commands.setup.completion import make_full_parser, make_manual
from steerd.daemon.cli.main import COMMANDS, run_cli

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
    argv = ["man", "--warnings", "-l", str(path)]
    plain = {"LANG": "C.UTF-8", "MANWIDTH": "80", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(argv, capture_output=True, text=True, check=True, env=plain)
    assert done.stderr == ""
    assert "teleop" in done.stdout
