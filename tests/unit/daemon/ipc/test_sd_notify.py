"""Notices to a service manager: they arrive, never block, and need no manager."""

import socket

import pytest

from steerd.daemon.ipc.sd_notify import make_notify


@pytest.mark.parametrize("abstract", [False, True])
def test_notifications_arrive_and_never_block(tmp_path, abstract):
    name = f"@steerd-test-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name[1:] if abstract else name)
        manager.settimeout(2.0)
        notify = make_notify({"NOTIFY_SOCKET": name})
        notify("READY=1")
        assert manager.recv(64) == b"READY=1"
        for _ in range(2000):  # more than the queue holds
            notify("WATCHDOG=1")
    notify("WATCHDOG=1")  # the manager is gone


def test_without_a_manager_nothing_happens():
    make_notify({})("READY=1")
    make_notify({"NOTIFY_SOCKET": "elsewhere"})("READY=1")
