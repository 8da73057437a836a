"""The service: a unit that says what it must, arguments that survive it, heartbeats."""

import configparser
import shlex
import shutil
import subprocess
import sys

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.cli.commands.service import make_unit
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError

OPTIONS = ["--port", "/dev/vesc", "--mocap", "natnet://10.0.0.2/car?up=y&unicast=1"]


def read(text):
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str
    parser.read_string(text)
    return parser


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config" / "systemd" / "user" / "steerd.service"


def test_install_print_uninstall(home, cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "car.toml").write_text(default_car_path().read_text())
    assert run_cli(["keys", "lab", "--host", "localhost"]) == 0
    options = [*OPTIONS, "--car", "car.toml", "--lab", "lab/car1"]
    said = cli("service", "install", "--user", *options).out
    assert "systemctl --user enable --now steerd" in said
    assert len(said.splitlines()) < 8
    unit = read(home.read_text())["Service"]
    assert (unit["Type"], unit["NotifyAccess"], unit["KillMode"]) == ("notify", "all", "mixed")
    assert 2 <= int(unit["WatchdogSec"]) <= 10
    assert shlex.split(unit["ExecStart"]) == [
        sys.executable, "-m", "steerd", "run", *OPTIONS,
        "--car", str(tmp_path / "car.toml"), "--lab", str(tmp_path / "lab" / "car1"),
    ]  # fmt: skip
    assert cli("service", "print", *options).out == home.read_text()
    other = [*options, "--speed", "0.5"]
    assert run_cli(["service", "install", *other]) == 2
    assert run_cli(["service", "install", "--force", *other]) == 0
    assert "--speed 0.5" in home.read_text()
    assert run_cli(["service", "uninstall", "--user"]) == 0
    assert not home.exists()
    assert run_cli(["service", "uninstall"]) == 3


def test_arguments_with_meaning_to_systemd_survive():
    words = ["steerd", "a b", "50%", "$HOME", "C:\\new\\table", 'say "it\'s"']
    unit = make_unit(words, "car1", account="driver")
    line = read(unit)["Service"]["ExecStart"]
    assert [w.replace("%%", "%").replace("$$", "$") for w in shlex.split(line)] == words
    assert "\\n" not in line.replace("\\\\", ""), "systemd reads an escape within quotes too"
    assert read(unit)["Install"]["WantedBy"] == "multi-user.target"
    with pytest.raises(SteerdError, match="unit file"):
        make_unit(["steerd", "a\nExecStartPre=x"], "car1")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd on this machine")
def test_systemd_finds_nothing_wrong(tmp_path):
    file = tmp_path / "steerd.service"
    file.write_text(make_unit([sys.executable, "-m", "steerd", "run"], "car1"))
    argv = ["systemd-analyze", "--user", "verify", str(file)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert "steerd.service" not in done.stderr, done.stderr


def test_a_unit_gives_no_rights_that_a_drive_does_not_need(monkeypatch, cli):
    monkeypatch.setenv("SUDO_USER", "driver")
    for whose, account in (("--user", None), ("--system", "driver")):
        unit = read(cli("service", "print", whose, *OPTIONS).out)["Service"]
        assert (unit["NoNewPrivileges"], unit["UMask"]) == ("yes", "0077")
        assert unit.get("User") == account
        assert unit.get("ProtectSystem") == (account and "full")


def test_udev(cli):
    rule = cli("service", "udev").out.splitlines()[-1]
    assert rule.startswith('SUBSYSTEM=="tty", ATTRS{idVendor}=="0483", ATTRS{idProduct}=="5740"')
    assert rule.endswith('MODE="0660", GROUP="dialout", SYMLINK+="vesc"')
