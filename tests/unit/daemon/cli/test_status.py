"""`steerd status` on a terminal of 80 columns."""

import contextlib
from types import SimpleNamespace

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.assembly.build import report_refusal
from steerd.daemon.cli.commands import run as command
from steerd.daemon.cli.commands.operate import format_status
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.settings.run_options import RunOptions

STATUS = {
    "state": "DISARMED", "reason": "start", "waiting": "an operator: steerd arm", "warnings": "",
    "firmware": "6.05", "uuid": "ab" * 12, "vesc_timeout_ms": "150", "mocap": "natnet streaming",
    "mocap_rate_hz": "240", "controller": "lane",
}  # fmt: skip


def test_one_line_for_each_fact():
    assert format_status("car1", STATUS) == [
        "car1: DISARMED — start",
        "waiting for: an operator: steerd arm",
        "VESC:        firmware 6.05, timeout 150 ms", "UUID:        abababababababababababab",
        "mocap:       natnet streaming, 240 Hz", "controller:  lane",
    ]  # fmt: skip


@pytest.mark.parametrize(("more", "shown"), [
    ({"warnings": "no priority\n\nlow battery"}, "warning:     no priority"),
    ({"warnings": "no priority\n\nlow battery"}, "warning:     low battery"),
    ({"design": "learnt 3", "design_why": ""}, "design:      learnt 3"),
    ({"design": "car file", "design_why": "silence"}, "design:      car file (silence)"),
])  # fmt: skip
def test_warnings_and_the_design_that_steers_have_lines_of_their_own(more, shown):
    assert shown in format_status("car1", STATUS | more)


# A simulated drive that its own machine ends goes on in virtual time, and says so.
@pytest.fixture
def drive(monkeypatch):
    """Drive options whose real time ends with this reason; the plans driven in virtual time."""

    def go(reason, code=ExitCode.STOPPED, **options):
        again = []
        monkeypatch.setattr(command, "Child", lambda module: SimpleNamespace(close=lambda: None))
        sim = contextlib.nullcontext(SimpleNamespace(port="/dev/x", mocap_url="natnet://x/car"))
        monkeypatch.setattr("steerd.sim_hw.real_time.links.spawn_sim", lambda _: sim)
        monkeypatch.setattr(command, "_run_live", lambda plan, core: (code, reason))
        fast = "steerd.daemon.offline.fast.run_fast"
        monkeypatch.setattr(fast, lambda plan: again.append(plan) or ExitCode.OK)
        given = {"car_file": "", "simulated": True, "auto_arm": True, "duration_s": 2.0}
        return command.drive(RunOptions(**{**given, **options}), fast=False), again

    return go


@pytest.mark.parametrize("reason", ["W15 loop late: …", "W7 telemetry stale: …"])
def test_a_busy_machine_is_no_failed_demo(drive, capsys, reason):
    code, (again,) = drive(reason, record="a.mcap")
    assert code == ExitCode.OK
    assert "this machine was too busy for real time" in capsys.readouterr().out
    assert again.options.record == "a.fast.mcap", "what was recorded in real time stays"
    assert again.options.port is None


@pytest.mark.parametrize(("reason", "options"), [
    ("", {"code": ExitCode.OK}), ("W17 lateral error: …", {}),
    ("W1 mocap stale: …", {"auto_arm": False}), ("W15 loop late: …", {"duration_s": None}),
    ("W7 telemetry stale: …", {"effects": ("drive_delay=0.1",)}),
    ("W7 telemetry stale: …", {"page": 0}), ("W7 telemetry stale: …", {"view": "8765"}),
])  # fmt: skip
def test_a_drive_that_ended_well_or_otherwise_is_driven_once(drive, reason, options):
    code = options.get("code", ExitCode.STOPPED)
    assert drive(reason, **options) == (code, [])


# A car file that a command wrote and `steerd run` would refuse is said to be so at once.
@pytest.mark.parametrize(("more", "said"), [
    ("", ""), ("\n[effects.rolling_drag]\ndrag = 3.0\n", "behind its orders"),
    ("\n[limitss]\n", "limits"),
])  # fmt: skip
def test_what_run_refuses_is_said_by_whoever_wrote_it(tmp_path, capsys, more, said):
    path = tmp_path / "car.toml"
    path.write_text(default_car_path().read_text() + more)
    report_refusal(load_car(path))
    noted = capsys.readouterr().err
    assert noted.startswith("note: `steerd run` refuses this file: ") is bool(said)
    assert said in noted
    refused = run_cli(["config", "--check", str(path)]) == ExitCode.INVALID
    assert refused is bool(said), "the note and the check agree"
