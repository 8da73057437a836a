"""The command line's last resorts: a bug, a reader that is gone, a key pressed in the middle."""

import os

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.process.core_process import _tell
from steerd.steer_bus.session_read import open_session


def test_a_bug_has_its_own_code_and_says_that_it_is_one(monkeypatch, capsys):
    def broken(args):
        raise ZeroDivisionError("in a command")

    monkeypatch.setattr("steerd.daemon.cli.commands.analysis.effects.run", broken)
    assert run_cli(["effects"]) == ExitCode.INTERNAL
    error = capsys.readouterr().err
    assert "ZeroDivisionError: in a command" in error
    assert error.splitlines()[-1].startswith("steerd: this is a bug in steerd")


def test_a_core_whose_parent_is_gone_has_nobody_to_tell():
    reading, writing = os.pipe()
    os.close(reading)
    _tell(writing, {"what": "no port"})
    os.close(writing)


def test_a_core_tells_its_parent():
    reading, writing = os.pipe()
    _tell(writing, {"what": "no port"})
    assert os.read(reading, 100) == b'{"what": "no port"}\n'
    os.close(reading)
    os.close(writing)


@pytest.mark.slow
def test_a_drive_that_was_interrupted_does_not_say_that_it_ended(tmp_path, monkeypatch, capsys):
    from steerd.daemon.offline import virtual

    def some(run, tick):
        def stopped(now):
            tick(now)
            if now.t_ns > 200_000_000:
                raise KeyboardInterrupt

        virtual.drive(run, stopped)

    monkeypatch.setattr("steerd.daemon.offline.fast.drive", some)
    path = tmp_path / "drive.mcap"
    argv = ["run", "--sim", "--fast", "--duration", "3", "--record", str(path)]
    assert run_cli(argv) == ExitCode.INTERRUPTED
    assert f"interrupted; what was driven so far: {path}" in capsys.readouterr().err
    info = open_session(path).info()
    assert info.metadata["steerd.end"]["reason"] == "interrupted"
    assert info.count > 10
