"""Keys in the terminal of a run and in `steerd watch`: live parameters, the lease, a servo."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from steerd.daemon.ipc.requests import format_setting, parse_setting, unpack_request
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import KEEPALIVE_NS, Operator
from steerd.daemon.setup.steering_calibration import SteeringCalibration, servo_scaling
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.daemon.terminal.key_desk import KEYS, nudge
from steerd.daemon.terminal.servo_keys import Servo, press
from steerd.daemon.terminal.terminal import Terminal
from steerd.daemon.terminal.watch import make_desk
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode
from steerd.steer_bus.topics import make_key
from steerd.vesc_link.scaling import F1TENTH, Scaling
from tests.local_bus import LocalBus, LocalHub

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


def test_an_arm_request_without_an_answer_is_held_until_the_answer_is_due():
    desk = Desk().show(SupervisorState.READY).press("a")
    assert desk.wait(1.5) == [KEYS["a"]] + [KEEPALIVE] * 30
    assert desk.wait(1.0) == []
    assert len(desk.press("a").wait(1.0)) == 21, "requested again, held again"


def test_disarm_lets_go_at_once():
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


def test_moves_stay_between_0_and_1():
    assert after("aaA").position == pytest.approx(0.5304 - 0.01 - 0.05)
    assert after(["\x1b[C", "\x1b[D", "d"]).position == pytest.approx(0.5354)
    assert (after("A" * 30).position, after("D" * 30).position) == (0.0, 1.0)


def test_centre_and_stops_are_set_where_the_servo_is():
    s = after("dd" + "c" + "AAAA" + "l" + "DDDDDDDD" + "r").scaling
    found = (s.servo_offset, s.servo_min, s.servo_max)
    assert found == pytest.approx((0.5404, 0.3404, 0.7404))
    mirrored = Scaling(servo_gain=1.0, servo_offset=0.5)
    s = after("DDDlAAAAAAr", mirrored).scaling
    assert (s.servo_min, s.servo_max) == pytest.approx((0.35, 0.65))


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
