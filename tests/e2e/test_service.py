"""A run under a service manager: it says that it is ready, alive and about to stop."""

import select
import socket

import pytest

pytestmark = pytest.mark.timeout(240)


def test_the_control_loop_feeds_the_watchdog(steerd, tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        run = steerd(
            "run", "--sim", "--auto-arm", "--duration", "2", "--listen", steerd.endpoint,
            "--record", tmp_path / "drive.mcap",
        )  # fmt: skip
        run.expect("RUNNING")
        assert manager.recv(64) == b"READY=1"
        assert run.wait() == 0, run.text
        heard = []
        while select.select([manager], [], [], 0.0)[0]:
            heard.append(manager.recv(64))
    assert heard[-1] == b"STOPPING=1"
    assert heard.count(b"WATCHDOG=1") >= 2
