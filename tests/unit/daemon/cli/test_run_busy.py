"""A simulated drive that its own machine ends goes on in virtual time, and says so."""

import contextlib
from types import SimpleNamespace

import pytest

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.cli.commands.driving import run as command
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.settings.run_options import RunOptions


@pytest.fixture
def drive(monkeypatch):
    """Drive options whose real time ends with this reason; the plans driven in virtual time."""

    def go(reason, code=ExitCode.STOPPED, **options):
        again = []
        monkeypatch.setattr(command, "prepared", lambda module: contextlib.nullcontext())
        sim = contextlib.nullcontext(SimpleNamespace(port="/dev/x", mocap_url="natnet://x/car"))
        monkeypatch.setattr("steerd.sim_hw.real_time.links.spawn_sim", lambda _: sim)
        monkeypatch.setattr(command, "_run_live", lambda plan, core: (code, reason))
        monkeypatch.setattr(
            "steerd.daemon.offline.fast.run_fast", lambda plan: again.append(plan) or ExitCode.OK
        )
        given = {"car_file": "", "simulated": True, "auto_arm": True, "duration_s": 2.0}
        plan = make_plan(RunOptions(**{**given, **options}), design=False)
        return command.drive(lambda: plan, fast=False), again

    return go


@pytest.mark.parametrize("reason", ["W15 loop late: …", "W7 telemetry stale: …"])
def test_a_busy_machine_is_no_failed_demo(drive, capsys, reason):
    code, (again,) = drive(reason, record="a.mcap")
    assert code == ExitCode.OK
    assert "this machine was too busy for real time" in capsys.readouterr().out
    assert again.options.record == "a.fast.mcap", "what was recorded in real time stays"
    assert again.options.port is None


@pytest.mark.parametrize(
    ("reason", "options"),
    [
        ("W17 lateral error: …", {}),
        ("W1 mocap stale: …", {"auto_arm": False}),
        ("W15 loop late: …", {"duration_s": None}),
        ("W7 telemetry stale: …", {"effects": ("drive_delay=0.1",)}),
        ("W7 telemetry stale: …", {"page": 0}),
        ("W7 telemetry stale: …", {"view": "8765"}),
    ],
)
def test_any_other_stop_stays_one(drive, reason, options):
    assert drive(reason, **options) == (ExitCode.STOPPED, [])


def test_a_drive_that_ended_well_is_driven_once(drive):
    assert drive("", ExitCode.OK) == (ExitCode.OK, [])
