"""The terminal's side of the lease: held while the car needs somebody, and no longer."""

from types import SimpleNamespace

import pytest

from steerd.daemon.ipc.operator import KEEPALIVE_NS, Operator
from steerd.daemon.ipc.requests import unpack_request
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.terminal.key_desk import KEYS
from steerd.daemon.terminal.terminal import Terminal
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import OperatorRequest, RequestKind

KEEPALIVE = int(RequestKind.KEEPALIVE)
HELD = [
    SupervisorState.SELF_TEST,
    SupervisorState.ARMED,
    SupervisorState.RUNNING,
    SupervisorState.STOPPING,
]
LET_GO = [state for state in SupervisorState if state not in HELD]


class Desk:
    """A terminal at which keys are pressed, of a car whose state is set."""

    def __init__(self):
        self.sent = []
        self.now_ns = 77 * 10**9
        self.board = SimpleNamespace(state=None)
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
        return [decode(OperatorRequest, unpack_request(packet)[1]).kind for packet in packets]


def test_nobody_holds_a_car_that_nobody_armed_or_started():
    assert Desk().show(SupervisorState.READY).wait(3.0) == []


@pytest.mark.parametrize("key", "as")
@pytest.mark.parametrize("state", HELD)
def test_who_arms_or_starts_the_car_holds_it_for_as_long_as_it_needs_somebody(key, state):
    desk = Desk().press(key).show(state)
    assert desk.wait(10.0) == [KEYS[key]] + [KEEPALIVE] * 200


@pytest.mark.parametrize("state", [None, *LET_GO])
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
