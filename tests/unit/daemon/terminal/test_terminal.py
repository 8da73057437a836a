"""The terminal of a run and of `steerd watch`: the dashboard, a run's last lines, the keys."""

import shutil
from dataclasses import replace
from math import nan, pi
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.ipc.requests import format_setting, parse_setting, unpack_request
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import KEEPALIVE_NS, Operator
from steerd.daemon.settings.run_options import RunOptions
from steerd.daemon.setup.steering_calibration import SteeringCalibration, servo_scaling
from steerd.daemon.terminal.dashboard import SETTLE_NS, Dashboard, Tally, closing_lines
from steerd.daemon.terminal.key_desk import KEYS, nudge
from steerd.daemon.terminal.servo_keys import Servo, press
from steerd.daemon.terminal.terminal import Terminal
from steerd.daemon.terminal.watch import SECOND, Watch, find_car, make_desk
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.topics import Sample, make_key
from steerd.vesc_link.scaling import F1TENTH, Scaling
from tests.blank import blank
from tests.local_bus import LocalBus, LocalHub

TICK_NS = 10_000_000


def state(t_ns, x=0.0, e1=0.0, mode=SupervisorState.RUNNING):
    return blank(m.StateMessage, mono_ns=t_ns, seq=1, mode=mode, x=x, yaw=pi, e1=e1)


def printed(what):
    console = Console(width=100)
    with console.capture() as caught:
        console.print(what)
    return caught.get()


def drive(tally, ticks, e1, start_ns=0, speed=1.5):
    for i in range(ticks):
        tally.add(state(start_ns + i * TICK_NS, x=speed * i * TICK_NS * 1e-9, e1=e1))
    return tally


def test_lateral_errors_count_after_settling_and_only_where_they_are_known():
    ticks = SETTLE_NS // TICK_NS
    tally = drive(Tally(), ticks, 0.5)
    assert (tally.count, tally.worst) == (0, 0.0)
    assert tally.describe() == "drove 4.5 m in 3.0 s"
    tally.add(state(SETTLE_NS, e1=-0.03))
    tally.add(state(SETTLE_NS + TICK_NS, e1=0.01))
    tally.add(state(SETTLE_NS + 2 * TICK_NS, e1=nan))
    assert (tally.count, tally.worst) == (2, 0.03)
    assert tally.rms == pytest.approx(((9e-4 + 1e-4) / 2) ** 0.5)
    assert "lateral error RMS 22.4 mm, largest 30.0 mm (after 3 s)" in tally.describe()
    assert "lateral" not in tally.describe(lane=False)


def test_a_stop_between_two_drives_is_not_driven_and_settles_anew():
    tally = drive(Tally(), 401, 0.0)
    tally.add(state(5_000_000_000, mode=SupervisorState.ARMED, x=90.0))
    before = tally.count
    drive(tally, 101, 0.4, start_ns=6_000_000_000)
    assert tally.count == before
    assert tally.distance == pytest.approx(6.0 + 1.5)
    assert tally.driven_ns == 5_000_000_000


def test_an_estimate_that_is_not_there_shows_no_number():
    board = Dashboard("car1")
    unknown = replace(state(1, x=nan, e1=nan), y=nan, yaw=nan, speed=nan)
    board.take(PipeRecord(topics.STATE, 0, 1, 1, encode(unknown)))
    text = printed(board.render())
    assert "nan" not in text
    assert "x       – m" in text


# The last lines of a run.
def lines(drill, car=None):
    plan = make_plan(RunOptions(str(car or default_car_path()), drill=drill), design=False)
    tally = Tally(count=4, square=4e-4, worst=0.02, distance=12.0, driven_ns=6_000_000_000)
    return list(closing_lines(plan, tally, Path("drive.mcap")))


def test_a_lane_was_kept():
    summary, where, then = lines("")
    assert summary.startswith("drove 12.0 m in 6.0 s; lateral error RMS 10.0 mm")
    assert where == "session: drive.mcap"
    assert "steerd plot drive.mcap" in then


@pytest.mark.parametrize(("drill", "lane"), [("mixed;speed=2", False), ("chirp;closed", True)])
def test_a_plan_was_driven_and_its_own_car_file_is_identified_from(drill, lane, tmp_path):
    summary, _, then = lines(drill)
    assert ("lateral error" in summary) is lane
    assert "steerd identify drive.mcap -o car.toml" in then
    own = shutil.copy(default_car_path(), tmp_path / "mine.toml")
    assert f"steerd identify drive.mcap --car {own} -o car.toml" in lines(drill, own)[-1]


# `steerd watch`: what it shows is what was received, and silence is not standing still.
def sample(name, message):
    return Sample(f"steerd/car1/{name}", encode(message))


def test_state_rates_and_faults():
    watch = Watch(Dashboard("car1"))
    moving = sample("state", replace(state(0, e1=0.012), speed=1.5))
    faulty = sample("vesc", blank(m.VescTelemetry, fault_code=4, v_in=11.5))
    for i in range(200):
        t = i * SECOND // 100
        watch.take(moving, t)
        if i % 2:
            watch.take(faulty, t)
    assert watch.rates(2 * SECOND) == pytest.approx({"state": 100, "vesc": 50}, abs=1)
    line = watch.line(2 * SECOND)
    assert line.startswith("RUNNING       +1.50 m/s, e1 +12.0 mm; state 100, vesc 50 Hz; fault ")
    assert "none" not in line
    text = printed(watch.render(2 * SECOND))
    for said in ("e1  +12.0 mm", "11.5 V", "state 100"):
        assert said in text


def test_silence_is_reported():
    watch = Watch(Dashboard("car1"))
    assert watch.silence(9 * SECOND) == 0.0
    watch.take(sample("state", state(0)), SECOND)
    assert watch.silence(2 * SECOND) == 0.0
    assert watch.silence(5 * SECOND) == 4.0
    assert "no message for 4.0 s" in watch.line(5 * SECOND)
    assert "no message for 4.0 s" in printed(watch.render(5 * SECOND))
    watch.take(sample("state", state(0)), 6 * SECOND)
    assert watch.silence(6 * SECOND) == 0.0


def test_what_is_no_message_of_ours_is_counted_and_requests_are_left_alone():
    watch = Watch(Dashboard("car1"))
    assert watch.take(Sample("steerd/car1/state", b"\0\1\0\0nonsense"), 0) is None
    assert watch.take(Sample("steerd/car1/diagnostics", b""), 0) is None
    assert watch.undecodable == 2
    assert watch.take(Sample("steerd/car1/cmd/drive", b"x"), 0) is None
    assert watch.take(Sample("other/key", b"x"), 0) is None
    assert watch.undecodable == 2
    states = (SupervisorState.ARMED, SupervisorState.RUNNING)
    change = m.Transition(m.make_header(0, m.BODY), *states, "c", "start requested")
    assert watch.take(sample("transition", change), 0) == "RUNNING       start requested"


def test_which_car():
    hub = LocalHub()
    here, there = LocalBus(hub), LocalBus(hub)
    with pytest.raises(SteerdError, match="no car is on the bus"):
        find_car(here, None)
    there.declare_alive("steerd/blue/alive")
    assert find_car(here, None) == "blue"
    assert find_car(here, "blue") == "blue"
    with pytest.raises(SteerdError, match="no car 'red'") as caught:
        find_car(here, "red")
    assert "blue" in caught.value.hint
    there.declare_alive("steerd/red/alive")
    with pytest.raises(SteerdError, match="several"):
        find_car(here, None)


# Keys in the terminal of a run and in `steerd watch`: live parameters, the lease, a servo.
LIVE = m.Parameters(
    m.make_header(0, m.BODY), 0, 0, 0, 1.0, 0.3, 1.45, 0.0, -0.15, 0.15, 1.0, 0.5, 1.2, ""
)


class Desk:
    """A terminal at which keys are pressed, of a car whose state is set."""

    def __init__(self):
        self.sent = []
        self.now_ns = 77 * 10**9
        self.board = SimpleNamespace(state=None, parameters=LIVE)
        clock = SimpleNamespace(now_ns=lambda: self.now_ns, realtime_ns=lambda: self.now_ns)
        processes = SimpleNamespace(requests=SimpleNamespace(send=self.sent.append), fds={})
        self.terminal = Terminal(processes, self.board, Operator(1, 77, "desk"), clock)

    def press(self, key):
        self.terminal._on_key(key)
        return self

    def show(self, state):
        self.board.state = SimpleNamespace(mode=int(state))
        return self

    def wait(self, seconds):
        """Let time pass; the kinds of all requests since the last time."""
        for _ in range(round(seconds * 1e9) // KEEPALIVE_NS):
            self.now_ns += KEEPALIVE_NS
            self.terminal._desk.keep_alive()
        packets, self.sent[:] = self.sent[:], []
        return [decode(m.OperatorRequest, unpack_request(packet)[1]).kind for packet in packets]


@pytest.mark.parametrize(("key", "wanted"), [
    ("+", {"speed": 1.1}), ("-", {"speed": 0.9}), ("<", {"offset": 0.01}), (">", {"offset": -0.01}),
    ("]", {"gain": 1.1}), ("[", {"gain": 0.9}), ("0", {"offset": 0.0, "gain": 1.0}),
])  # fmt: skip
def test_a_key_is_a_step(key, wanted):
    assert nudge(LIVE, {}, key) == wanted


def test_the_last_step_leads_to_the_bound_and_the_next_is_the_cars_to_refuse():
    assert nudge(replace(LIVE, speed=1.4), {}, "+") == {"speed": 1.45}
    assert nudge(replace(LIVE, speed=1.45), {}, "+")["speed"] > 1.45
    assert nudge(replace(LIVE, speed=0.35), {}, "-") == {"speed": 0.3}
    assert nudge(replace(LIVE, speed=0.3), {}, "-")["speed"] < 0.3


def test_a_viewers_setting_goes_out_under_the_terminals_lease():
    desk = Desk()
    packets = iter([b"set gain 1.1", b"set mass 9", b""])
    viewer = SimpleNamespace(recv=lambda _most: next(packets))
    assert [desk.terminal._pass_setting(viewer) for _ in range(3)] == [True, True, False]
    out = [unpack_request(packet) for packet in desk.press("+").sent]
    assert {name for name, _ in out} == {topics.SET_PARAMETERS.name}
    gain, speed = (decode(m.ParameterRequest, data) for _, data in out)
    assert (gain.gain, speed.speed) == (1.1, 1.1)
    assert [(r.boot_id, r.lease_id, r.seq) for r in (gain, speed)] == [(1, 77, 1), (1, 77, 2)]
    assert [r.operator for r in (gain, speed)] == ["viewer", "desk"], "who set it is said"
    assert parse_setting(format_setting("offset", 0.1 + 0.2)) == {"offset": 0.1 + 0.2}, "to the bit"


@pytest.mark.parametrize("operate", [False, True])
def test_the_keys_of_a_watch(operate):
    hub = LocalHub()
    car = LocalBus(hub)
    asked = car.subscribe(make_key("car1", topics.OPERATOR), 9)
    stops = car.subscribe(make_key("car1", topics.STOP), 9)
    tuned = car.subscribe(make_key("car1", topics.SET_PARAMETERS), 9)
    board = Dashboard("watch", parameters=LIVE)
    desk, repeat = make_desk(board, LocalBus(hub), "car1", MonotonicClock(), operate=operate)
    desk.on_key("e")
    kinds = [decode(m.OperatorRequest, sample.data).kind for sample in stops.poll()]
    assert kinds == ([KEYS["e"]] if operate else []), "a stop needs to know nothing of the car"
    assert repeat() is operate
    desk.on_key("+")
    assert tuned.poll() == [], "not before the car's run is known"
    board.status["boot_id"] = "5"
    for key in "+a+x ":
        desk.on_key(key)
    speeds = [decode(m.ParameterRequest, sample.data) for sample in tuned.poll()]
    assert [(s.boot_id, s.speed) for s in speeds] == [(5, 1.2), (5, 1.3)], "faster than the answer"
    board.parameters = replace(LIVE, speed=0.7)
    desk.on_key("+")
    assert [decode(m.ParameterRequest, sample.data).speed for sample in tuned.poll()] == [0.8]
    kinds = [decode(m.OperatorRequest, s.data).kind for s in (*asked.poll(), *stops.poll())]
    assert kinds == ([KEYS["a"], KEYS[" "]] if operate else [])
    assert desk.holding is operate


# The lease: held while the car needs somebody, and no longer.
KEEPALIVE = int(m.RequestKind.KEEPALIVE)
HELD = [SupervisorState[name] for name in ("SELF_TEST", "ARMED", "RUNNING", "STOPPING")]


@pytest.mark.parametrize("key", "as")
@pytest.mark.parametrize("state", HELD)
def test_who_arms_or_starts_the_car_holds_it_for_as_long_as_it_needs_somebody(key, state):
    desk = Desk().press(key).show(state)
    assert desk.wait(10.0) == [KEYS[key]] + [KEEPALIVE] * 200


@pytest.mark.parametrize("state", [None, *(s for s in SupervisorState if s not in HELD)])
def test_a_parked_or_faulted_car_is_let_go(state):
    desk = Desk().press("a").show(SupervisorState.RUNNING)
    desk.wait(10.0)
    desk.board.state = None if state is None else SimpleNamespace(mode=int(state))
    assert desk.wait(1.0) == []
    assert desk.show(SupervisorState.ARMED).wait(1.0) == [], "armed again by somebody else"


def test_an_arm_request_without_an_answer_is_held_until_it_is_due_and_disarm_lets_go_at_once():
    desk = Desk().show(SupervisorState.READY).press("a")
    assert desk.wait(1.5) == [KEYS["a"]] + [KEEPALIVE] * 30
    assert desk.wait(1.0) == []
    assert len(desk.press("a").wait(1.0)) == 21, "requested again, held again"
    desk = Desk().press("a").show(SupervisorState.ARMED)
    desk.wait(1.0)
    assert desk.press("d").wait(1.0) == [KEYS["d"]]


@pytest.mark.parametrize("key", " ce")
def test_other_keys_take_no_hold_and_lose_none(key):
    desk = Desk().show(SupervisorState.RUNNING)
    assert desk.press(key).wait(1.0) == [KEYS[key]], "somebody else's car"
    desk.press("s").wait(1.0)
    assert desk.press(key).wait(1.0) == [KEYS[key]] + [KEEPALIVE] * 20


# Keys move the servo and set its centre and stops; the session's servo becomes a new scaling.
def after(keys, scaling=F1TENTH):
    servo = Servo(scaling.servo_offset, scaling)
    for key in keys:
        servo = press(servo, key)
    return servo


def test_centre_and_stops_are_set_where_the_servo_is_between_0_and_1():
    s = after("dd" + "c" + "AAAA" + "l" + "DDDDDDDD" + "r").scaling
    found = (s.servo_offset, s.servo_min, s.servo_max)
    assert found == pytest.approx((0.5404, 0.3404, 0.7404))
    mirrored = Scaling(servo_gain=1.0, servo_offset=0.5)
    s = after("DDDlAAAAAAr", mirrored).scaling
    assert (s.servo_min, s.servo_max) == pytest.approx((0.35, 0.65))
    assert after("aaA").position == pytest.approx(0.5304 - 0.01 - 0.05)
    assert after(["\x1b[C", "\x1b[D", "d"]).position == pytest.approx(0.5354)
    assert (after("A" * 30).position, after("D" * 30).position) == (0.0, 1.0)


def test_stops_that_cannot_be_are_refused_and_other_keys_do_nothing():
    with pytest.raises(ValueError, match="servo limits"):
        after("DDDDDDDDl")
    assert after(["", "x", "\x1b"]) == Servo(0.5304, F1TENTH)


def test_limits_move_inwards_to_the_stops_only():
    found = SteeringCalibration(
        gain=0.9, bias=0.02, delay=0.05, left=0.2, right=-0.18, clipped_left=False,
        clipped_right=False, sd_gain=0.0, sd_bias=0.0, warnings=(),
    )  # fmt: skip
    free = servo_scaling(found, F1TENTH)
    assert (free.servo_min, free.servo_max) == (0.15, 0.85)
    stopped = replace(found, gain=1.0, bias=0.0, clipped_left=True, clipped_right=True)
    new = servo_scaling(stopped, F1TENTH)
    limits = (0.5304 - 1.2135 * 0.2, 0.5304 + 1.2135 * 0.18)
    assert (new.servo_min, new.servo_max) == pytest.approx(limits)
