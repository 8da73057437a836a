"""A run under a service manager, in a lab with certificates: who is heard, and what it says."""

import select
import socket

import pytest

from tests.safety.live import free_port

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(240)


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """A service manager's socket; what it has heard since it was last asked."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ears:
        ears.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))

        def hear():
            heard = []
            while select.select([ears], [], [], 0.0)[0]:
                heard.append(ears.recv(64))
            return heard

        yield hear


def test_operators_command_viewers_watch_and_the_manager_hears_the_loop(
    steerd, manager, tmp_path, cli
):
    lab, port = tmp_path / "lab", free_port()
    people = ("--operator", "desk", "--viewer", "screen")
    cli("keys", lab, "--host", "127.0.0.1", "--port", port, *people)
    run = steerd("run", "--sim", "--lab", lab / "car1", "--record", tmp_path / "drive.mcap")
    run.expect("READY")
    begun = manager()
    screen = ("--lab", lab / "screen")
    assert cli("status", *screen).out.startswith("car1: ")
    assert "the car stays" in cli("estop", *screen, code=5).err
    assert "state " in cli("watch", *screen, "--seconds", "1.5").out
    assert "no steerd answers" in cli("status", "--connect", f"tls/127.0.0.1:{port}", code=6).err
    run.pump(0.0)
    assert "ESTOP" not in run.text, run.text
    cli("estop", "--lab", lab / "desk")
    heard = manager()
    run.interrupt()
    assert "ESTOP" in run.text, run.text
    assert begun[0] == b"READY=1"
    assert heard.count(b"WATCHDOG=1") >= 2
    assert manager()[-1] == b"STOPPING=1"
