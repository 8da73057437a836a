"""`steerd arm`, `start`, `stop`, `estop` on an in-process bus, and what `status` says."""

import os
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.assembly.build import report_refusal
from steerd.daemon.cli.commands import operate
from steerd.daemon.cli.commands import run as command
from steerd.daemon.cli.commands.operate import format_status
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.ipc.requests import make_badge
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process import bus_operator
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import OperatorRequest, RequestKind
from steerd.steer_bus.topics import make_key
from tests.blank import blank, status_message
from tests.local_bus import LocalBus, LocalHub

# Time passes in sleeps alone.
OBEYED = {
    RequestKind.ARM: SupervisorState.ARMED, RequestKind.START: SupervisorState.RUNNING,
    RequestKind.STOP: SupervisorState.STOPPING, RequestKind.ESTOP: SupervisorState.ESTOP,
}  # fmt: skip


class Bench:
    """A car on a bus, and the clock of whoever operates it."""

    def __init__(self, state="READY", **status):
        self.hub = LocalHub()
        self._bus = LocalBus(self.hub)
        self._heard = self._bus.subscribe("steerd/car1/cmd/**", 4096)
        self.state, self.speaks = SupervisorState[state], True  # of the car, which says how it is
        self.deaf = 0  # so many requests it does not hear
        self.garbles = {}  # bytes that come instead of what it says, by topic
        self._status = {"boot_id": "7", "waiting": "arm", "holder": "0", "leased": "1", **status}
        self.t_ns, self.asked = 0, []  # requests so far, with their times [s] and keys

    def now_ns(self):
        return self.t_ns

    def realtime_ns(self):
        return self.t_ns + 10**18

    def sleep_until_ns(self, deadline_ns):
        self.t_ns = deadline_ns
        for sample in self._heard.poll():
            request = decode(OperatorRequest, sample.data)
            kind = RequestKind(request.kind)
            self.asked.append((self.t_ns * 1e-9, sample.key, kind, request.lease_id))
            if self.deaf:
                self.deaf -= 1
            else:
                self.state = OBEYED.get(kind, self.state)
        if self.speaks:
            self._speak()

    def _speak(self):
        told = status_message(**{"state": self.state.name, **self._status})
        said = {topics.STATE: blank(m.StateMessage, mode=self.state), topics.DIAGNOSTICS: told}
        for topic, message in said.items():
            data = self.garbles.get(topic.name, encode(message))
            self._bus.publish(make_key("car1", topic), data)


@pytest.fixture
def bench(monkeypatch):
    """A car with this status."""

    def with_car(**status):
        made = Bench(**status)
        monkeypatch.setattr(operate, "connect", lambda *_: nullcontext(LocalBus(made.hub)))
        monkeypatch.setattr(operate, "MonotonicClock", lambda: made)
        return made

    return with_car


@pytest.mark.parametrize(("line", "state", "code", "said"), [
    *((line, state, 2, (f"{line}: this car has a deadman", "deadman = false"))
      for line, state in (("arm --no-hold", "READY"), ("start --no-hold", "ARMED"))),
    ("start", "READY", 5, ("the car is READY, not ARMED",)),
])  # fmt: skip
def test_what_is_not_for_this_car_is_said_and_not_sent(bench, cli, line, state, code, said):
    car = bench(state=state)
    heard = cli(*line.split(), code=code).err
    assert all(words in heard for words in said)
    assert car.asked == []


@pytest.mark.parametrize(("line", "state", "leased"), [
    ("arm --no-hold", "READY", "0"), ("stop", "RUNNING", "1"), ("estop", "RUNNING", "1"),
])  # fmt: skip
def test_what_the_car_does_not_do_is_not_confirmed(bench, cli, line, state, leased):
    car = bench(state=state, leased=leased)
    car.deaf = 10_000
    assert f"{line.split()[0]}: the car stays {state}" in cli(*line.split(), code=5).err


@pytest.mark.parametrize(("line", "state", "last"), [
    ("arm", "READY", RequestKind.DISARM), ("start", "ARMED", RequestKind.STOP),
])  # fmt: skip
def test_who_is_left_alone_lets_go(bench, monkeypatch, line, state, last):
    """`ssh car steerd start`: Ctrl-C ends the ssh, and what it started gets no signal."""
    car, (reader, writer), shown = bench(state=state), os.pipe(), os.dup(1)
    sleep_until_ns = car.sleep_until_ns

    def sleep(deadline_ns):
        sleep_until_ns(deadline_ns)
        if car.t_ns == 3 * 10**9:
            os.close(reader)
        assert car.t_ns < 4 * 10**9, "nobody holds the car any more"

    monkeypatch.setattr(car, "sleep_until_ns", sleep)
    os.dup2(writer, 1)
    os.close(writer)
    code = run_cli([line])
    os.dup2(shown, 1)
    os.close(shown)
    sleep_until_ns(car.t_ns)
    assert (code, car.asked[-1][2]) == (ExitCode.INTERRUPTED, last)


STOPPING = pytest.mark.parametrize("name", ["stop", "estop"])


@STOPPING
def test_a_stop_is_out_before_anything_is_known_and_until_it_is_seen(bench, name):
    car = bench(state="RUNNING")
    assert run_cli([name]) == 0
    (first, key, kind, _), *rest = car.asked
    assert (first, key) == (0.01, "steerd/car1/cmd/stop")
    assert kind.name.lower() == name
    assert 4 <= len(rest) <= 6, "for a tenth of a second it is repeated in any case"


@STOPPING
def test_a_stop_is_repeated_every_20_ms_for_a_car_that_does_not_hear(bench, name):
    car = bench(state="RUNNING")
    car.deaf = 40
    assert run_cli([name]) == 0
    times = [t for t, _, _, _ in car.asked]
    assert times[40] == pytest.approx(0.81, abs=0.02)
    assert len(times) <= 42


@STOPPING
@pytest.mark.parametrize("garbage", [b"", b"\0\1\0\0", b"\xff" * 400])
def test_no_garbled_status_ends_a_stop(bench, cli, name, garbage):
    """A version mismatch is enough to make every message unreadable."""
    car = bench(state="RUNNING")
    car.garbles = {topics.STATE.name: garbage, topics.DIAGNOSTICS.name: garbage}
    assert f"{name} was sent for 5 s, and no car 'car1' shows it" in cli(name, code=6).err
    assert len(car.asked) == pytest.approx(250, abs=2)
    assert car.state in (SupervisorState.STOPPING, SupervisorState.ESTOP)


@STOPPING
def test_a_state_of_another_version_does_not_end_a_stop(bench, name):
    bench(state="RUNNING", boot_id="seven")
    assert run_cli([name]) == 0, "the state alone confirms it"


def test_nobody_there_is_said(bench, cli):
    car = bench()
    car.speaks = False
    assert "no car 'car1' on the bus" in cli("arm", "--no-hold", code=6).err
    assert run_cli(["estop"]) == 6


def test_start_shares_the_lease_of_this_user_s_arm_alone(bench, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    car = bench(leased="0")
    assert run_cli(["arm", "--no-hold"]) == 0
    ((_, _, kind, drawn), *_) = car.asked
    assert kind is RequestKind.ARM, "without a deadman a command that leaves may"
    (file,) = tmp_path.rglob("lease-car1")
    assert file.stat().st_mode & 0o777 == 0o600
    assert bus_operator.recall_lease("car1") == drawn
    for holder, shares in ((make_badge("", drawn), True), (drawn, False), (5, False)):
        car = bench(state="ARMED", leased="0", holder=str(holder))
        assert run_cli(["start", "--no-hold"]) == 0
        assert (car.asked[0][3] == drawn) is shares
    file.write_text("no number")
    assert bus_operator.recall_lease("car1") == 0


# `steerd status` on a terminal of 80 columns.
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


def test_warnings_and_the_design_that_steers_have_lines_of_their_own():
    more = {"warnings": "no priority\n\nlow battery", "design": "car file", "design_why": "silence"}
    said = {*format_status("car1", STATUS | more)} - {*format_status("car1", STATUS)}
    design = "design:      car file (silence)"
    assert said == {"warning:     no priority", "warning:     low battery", design}


# A simulated drive that its own machine ends goes on in virtual time, and says so.
@pytest.fixture
def drive(monkeypatch):
    """Drive options whose real time ends with this reason; the plans driven in virtual time."""

    def go(reason, code=ExitCode.STOPPED, **options):
        again = []
        monkeypatch.setattr(command, "Child", lambda module: SimpleNamespace(close=lambda: None))
        sim = nullcontext(SimpleNamespace(port="/dev/x", mocap_url="natnet://x/car"))
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
