"""A full disk: one line, an exit code, and what was written can be recovered."""

import os
from pathlib import Path

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.steer_bus.session_read import open_session
from tests.csv_logs import write_log

SIM = ("--sim", "--fast", "--duration", "4", "--record")
HINT = "free some space"


def is_clear(said: str) -> None:
    lines = said.splitlines()
    assert len(lines) == 2, said
    assert lines[0].startswith("steerd: ")
    assert "cannot be written: File too large" in lines[0]
    assert HINT in lines[1]


@pytest.mark.slow
@pytest.mark.parametrize("command", [("run",), ("collect", "--plan", "circles")])
@pytest.mark.parametrize("size", [0, 2_000, 40_000, 150_000])
def test_a_drive_ends_with_one_line(command, size, tmp_path, room_for, cli):
    path = tmp_path / "drive.mcap"
    room_for(size)
    said = cli(*command, *SIM, path, code=3).err
    room_for()
    is_clear(said)
    assert not path.exists()
    partial = path.with_name("drive.mcap.partial")
    if size < 40_000:
        assert not partial.exists(), "it held nothing"
        return
    assert partial.stat().st_size == size
    cli("recover", path)
    assert open_session(tmp_path / "drive.recovered.mcap").info().count > 100


@pytest.mark.slow
def test_a_recovery_and_a_page_without_room(tmp_path, room_for, cli):
    path = tmp_path / "drive.mcap"
    room_for(100_000)
    cli("run", *SIM, path, code=3)
    room_for(20_000)
    said = cli("recover", path, code=3).err
    assert said.splitlines()[-2].endswith("cannot be written: File too large")
    assert HINT in said.splitlines()[-1]
    room_for()
    cli("recover", path)
    recovered = tmp_path / "drive.recovered.mcap"
    assert f"steerd recover {path}" in cli("info", path, code=3).err
    room_for(1_000)
    said = cli("plot", recovered, "-o", tmp_path / "drive.html", code=3).err
    room_for()
    assert "drive.html: File too large" in said.splitlines()[-2]
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "drive.mcap.partial", "drive.recovered.mcap"
    ]  # fmt: skip


@pytest.mark.parametrize("size", [0, 2_000, 20_000])
def test_an_import_leaves_nothing_and_promises_nothing(size, tmp_path, room_for, cli):
    rows = [(k / 100, k / 99, 1.0, 0.1, 0.0, 1.0) for k in range(3000)]
    (log, the_map), out = write_log(tmp_path, rows, "log"), tmp_path / "log.mcap"
    words = ("import", "csv", log, "--map", the_map, "-o", out)
    room_for(size)
    said = cli(*words, code=3).err
    room_for()
    is_clear(said)
    assert "recover" not in said, "nothing is left that could be recovered"
    assert sorted(tmp_path.iterdir()) == [log, the_map]
    cli(*words)


def test_an_output_that_takes_nothing(monkeypatch, capfd):
    with Path("/dev/full").open("w") as nothing:
        monkeypatch.setattr("sys.stdout", nothing)
        saved = os.dup(1)
        try:
            assert run_cli(["config"]) == 3
        finally:
            os.dup2(saved, 1)
            os.close(saved)
        said = capfd.readouterr().err
    assert "No space left on device" in said
    assert "Traceback" not in said
