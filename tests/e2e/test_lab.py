"""A lab with certificates, as processes: operators are heard, viewers only watch."""

import signal

import pytest

from steerd.daemon.cli.main import run_cli
from tests.safety.live import free_port

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(240)


def test_operators_command_and_viewers_watch(steerd, tmp_path):
    lab = tmp_path / "lab"
    people = ["--operator", "desk", "--viewer", "screen"]
    where = ["--host", "127.0.0.1", "--port", str(free_port())]
    assert run_cli(["keys", str(lab), *where, *people]) == 0
    run = steerd("run", "--sim", "--lab", lab / "car1", "--record", tmp_path / "drive.mcap")
    run.expect("READY")
    code, said = steerd.run("status", "--lab", lab / "screen")
    assert (code, said.startswith("car1: ")) == (0, True), said
    code, said = steerd.run("estop", "--lab", lab / "screen")
    assert (code, "the car stays" in said) == (5, True), said
    code, said = steerd.run("watch", "--lab", lab / "screen", "--seconds", "1.5")
    assert (code, "state " in said) == (0, True), said
    code, said = steerd.run("status", "--connect", "tls/127.0.0.1:" + where[3])
    assert (code, "no steerd answers" in said) == (6, True), said
    assert "ESTOP" not in run.text, run.text
    assert steerd.run("estop", "--lab", lab / "desk")[0] == 0
    run.send(signal.SIGINT)
    run.wait()
    assert "ESTOP" in run.text, run.text
