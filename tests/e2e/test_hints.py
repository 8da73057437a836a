"""Commands that a command prints are run as they are printed, on the session that made them."""

import re
import shlex
from dataclasses import replace

import pytest

from steerd.daemon.analysis.drives import Drives
from steerd.daemon.cli.main import run_cli
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.sim_gap.verdict.next_manoeuvre import MENU
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session
from steerd.sysid.inference.identifiability import MANOEUVRES

pytestmark = pytest.mark.slow

TYPED = re.compile(r"^\s*(?:next:?|try:)?\s*(steerd [a-z].*?)(?:\s{3,}\(.*)?$", re.MULTILINE)
TICKED = re.compile(r"`(steerd [^`]*)`")
DRIVES = {
    "a mixed.mcap": "collect --plan mixed --duration 20 --sim-car hidden:3",
    "late.mcap": "run --path figure8 --speed 1.8 --duration 15 --effect steer_delay=0.05",
    "gentle.mcap": "run --path circle:radius=3 --speed 1 --duration 12 --sim-car hidden:3",
}


def typed(text):
    return [found.strip() for found in (*TYPED.findall(text), *TICKED.findall(text))]


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hall")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, words in DRIVES.items():
            assert run_cli([*shlex.split(words), "--sim", "--fast", "--record", name]) == 0
    return folder


ASKED = [
    "identify 'a mixed.mcap' -o 'a car.toml'",
    "diagnose late.mcap -o 'late car.toml' --no-pairs --only steer_delay --no-closed-loop",
    "diagnose gentle.mcap --no-pairs --only steer_lag --only steer_delay --no-closed-loop",
    "info 'a mixed.mcap'",
    "calibrate servo 'a mixed.mcap' -o servo.toml",
]


def test_what_is_recorded_is_named_as_a_shell_takes_it(tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    words = "collect --plan slalom --duration 2 --sim --fast --record 'a b.mcap'"
    assert typed(cli(*shlex.split(words)).out) == ["steerd identify 'a b.mcap' -o car.toml"]


@pytest.mark.parametrize("asked", ASKED)
def test_what_is_printed_runs(asked, hall, monkeypatch, capsys):
    monkeypatch.chdir(hall)
    run_cli(shlex.split(asked))
    said = capsys.readouterr()
    for command in typed(said.out) + typed(said.err):
        assert "…" not in command
        assert ends(command) in (0, 5), f"{asked}: {command}: {capsys.readouterr().err}"


def ends(command):
    try:
        return run_cli(shlex.split(command)[1:])
    except SystemExit as stopped:  # --help
        return stopped.code


def test_every_manoeuvre_runs_on_the_session_that_asked_for_it(hall, monkeypatch, capsys):
    monkeypatch.chdir(hall)
    sessions = [open_session("a mixed.mcap")]
    hints = [*(f"`{drive.command}`" for drive in MENU.values()), *MANOEUVRES.values()]
    commands = {c for hint in hints for c in typed(Drives(tuple(sessions), ()).complete(hint))}
    assert len(commands) >= len(MENU)
    for command in sorted(commands):
        assert "--sim --fast --sim-car hidden:3" in command
        ends_soon = command.replace(" --duration 20", "") + " --duration 2"
        assert ends(ends_soon) == 0, capsys.readouterr().err


def test_of_a_car_its_port_and_mocap_and_of_a_log_the_plans(tmp_path):
    car = RunOptions("", port="/dev/vesc", mocap="vrpn://lab/my car")

    def told(hint, **metadata):
        path = tmp_path / f"{len([*tmp_path.iterdir()])}.mcap"
        SessionWriter(path, {}, {"steerd.session": metadata}).finish({})
        return Drives((open_session(path),), ()).complete(hint)

    hint = "steps (`steerd collect --plan steps`)"
    ours = {"options": encode_options(car)}
    command = "steerd collect --plan steps --port /dev/vesc --mocap 'vrpn://lab/my car'"
    assert told(hint, **ours) == f"steps (`{command}`)"
    assert told(hint, mode="import") == "steps (see `steerd collect --help`)"
    without = {"options": encode_options(replace(car, mocap=None))}
    assert typed(told(hint, **without)) == ["steerd collect --help"]
