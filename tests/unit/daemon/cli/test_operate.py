"""What `steerd arm` and `steerd start` refuse before anything moves."""

import contextlib

import pytest

from steerd.daemon.cli.commands.driving import operate
from steerd.daemon.cli.main import run_cli


class QuietBus:
    """A bus on which nobody else talks; keeps what is sent."""

    def __init__(self):
        self.sent = []

    def publish(self, key, data):
        self.sent.append(key)

    def subscribe(self, key, depth=1):
        return self

    def poll(self):
        return []


@pytest.fixture
def bus(monkeypatch):
    """A bus with a car whose status the test gives."""

    def with_car(**status):
        made = QuietBus()
        values = {"boot_id": "7", "state": "READY", "waiting": "arm", "holder": "0", **status}
        monkeypatch.setattr(operate, "connect", lambda *_: contextlib.nullcontext(made))
        monkeypatch.setattr(operate, "read_status", lambda *_: values)
        return made

    return with_car


@pytest.mark.parametrize(("name", "state"), [("arm", "READY"), ("start", "ARMED")])
def test_a_car_with_a_deadman_is_not_armed_by_a_command_that_leaves(bus, capsys, name, state):
    quiet = bus(leased="1", state=state)
    assert run_cli([name, "--no-hold"]) == 2
    said = capsys.readouterr().err
    assert f"{name} --no-hold: this car has a deadman" in said
    assert "deadman = false" in said
    assert quiet.sent == []


def test_without_a_deadman_it_is(bus):
    quiet = bus(leased="0", state="ARMED")
    assert run_cli(["arm", "--no-hold"]) == 0
    assert len(quiet.sent) == 1


def test_a_car_that_is_not_armed_is_not_started(bus, capsys):
    quiet = bus(leased="1", state="READY")
    assert run_cli(["start"]) == 5
    assert "the car is READY, not ARMED" in capsys.readouterr().err
    assert quiet.sent == []
