"""A gamepad on the bus: nothing without the deadman, a stop when it is released."""

from types import SimpleNamespace

import pytest
from steerd.daemon.process.gamepad import ABS, AXES, BUTTONS, KEY, XBOX_AXES, PadEvent, PadMap

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import CarView
from steerd.daemon.process.teleop import PERIOD_NS, VALID_MS, Teleop
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import DriveCommand, OperatorRequest, RequestKind
from steerd.steer_bus.topics import make_key
from tests.local_bus import LocalBus, LocalHub

DEADMAN, GO, ESTOP = BUTTONS["tl"], BUTTONS["start"], BUTTONS["east"]
S = 10**9


class Desk:
    """A gamepad on an in-process bus, and what it sends."""

    def __init__(self, **pads):
        hub = LocalHub()
        car = LocalBus(hub)
        self._asked = car.subscribe(make_key("car1", topics.OPERATOR), 4096)
        self._stops = car.subscribe(make_key("car1", topics.STOP), 4096)
        self._driven = car.subscribe(make_key("car1", topics.DRIVE), 4096)
        self.now_ns = 9 * S
        clock = SimpleNamespace(now_ns=lambda: self.now_ns, realtime_ns=lambda: self.now_ns)
        self.view = CarView(LocalBus(hub), "car1", clock)
        self.teleop = Teleop(self.view, PadMap(**pads), XBOX_AXES)
        self.show(SupervisorState.READY)

    def show(self, state, boot_id="5"):
        self.view.state = SimpleNamespace(mode=int(state))
        self.view.values = {"boot_id": boot_id}

    def press(self, code, value=1):
        self.teleop.take([PadEvent(KEY, code, value)])

    def move(self, axis, value):
        self.teleop.take([PadEvent(ABS, AXES[axis], value)])

    def wait(self, seconds):
        """Let time pass; what was said."""
        said = []
        for _ in range(round(seconds * S) // PERIOD_NS):
            self.now_ns += PERIOD_NS
            said.append(self.teleop.step())
        return [line for line in said if line]

    def asked(self):
        requests = [decode(OperatorRequest, s.data) for s in self._asked.poll()]
        assert [r.seq for r in requests] == sorted({r.seq for r in requests})
        return [RequestKind(r.kind) for r in requests]

    def stops(self):
        return [RequestKind(decode(OperatorRequest, s.data).kind) for s in self._stops.poll()]

    def driven(self):
        return [decode(DriveCommand, s.data) for s in self._driven.poll()]


@pytest.fixture
def desk():
    return Desk()


@pytest.fixture
def held(desk):
    """A desk whose deadman is held."""
    desk.press(DEADMAN)
    return desk


def test_nothing_is_sent_while_nobody_holds_the_deadman(desk):
    desk.move("rz", 1023)
    desk.press(GO)
    assert desk.wait(1.0) == []
    assert (desk.asked(), desk.driven()) == ([], [])


def test_who_holds_it_is_operator_and_controller(held):
    held.wait(1.0)
    assert held.asked().count(RequestKind.KEEPALIVE) >= 16, "twenty a second, in steps of 20 ms"
    commands = held.driven()
    assert len(commands) == 50
    assert {(c.boot_id, c.valid_ms) for c in commands} == {(5, VALID_MS)}
    assert len({c.lease_id for c in commands}) == 1
    assert [c.seq for c in commands] == list(range(commands[0].seq, commands[0].seq + 50))


def test_start_arms_a_ready_car_and_starts_an_armed_one(held):
    held.press(GO)
    held.press(GO, 0)
    held.show(SupervisorState.ARMED)
    held.press(GO)
    held.show(SupervisorState.RUNNING)
    held.press(GO)
    assert held.asked() == [RequestKind.ARM, RequestKind.START]


def test_axes_drive_a_running_car_only():
    desk = Desk(speed_max=2.0, steer_max=0.3)
    desk.press(DEADMAN)
    desk.move("rz", 1023)
    desk.move("x", -32768)
    desk.wait(0.1)
    assert {(c.steer, c.speed) for c in desk.driven()} == {(0.0, 0.0)}
    desk.show(SupervisorState.RUNNING)
    desk.wait(0.1)
    assert {(c.steer, c.speed) for c in desk.driven()} == {(0.3, 2.0)}


def fall_silent(desk):
    assert "no event of the gamepad for 2 s" in desk.wait(2.1)[0]


RELEASES = {
    "by hand": lambda desk: desk.press(DEADMAN, 0), "by silence": fall_silent,
    "by lost events": lambda desk: desk.teleop.take([PadEvent(0, 3, 0)]),
}  # fmt: skip


@pytest.mark.parametrize("let_go", RELEASES.values(), ids=RELEASES)
def test_a_release_is_a_stop_and_then_silence(desk, let_go):
    desk.show(SupervisorState.RUNNING)
    desk.press(DEADMAN)
    desk.move("rz", 1023)
    desk.wait(0.5)
    let_go(desk)
    assert set(desk.stops()) == {RequestKind.STOP}
    desk.wait(0.2)
    assert len(desk.stops()) == 10, "again every 20 ms, until the car shows it"
    desk.show(SupervisorState.STOPPING)
    desk.wait(0.1)
    assert desk.stops() == []
    assert RequestKind.KEEPALIVE in desk.asked()
    desk.driven()
    desk.move("rz", 1023)
    desk.press(GO)
    assert desk.wait(3.0) == []
    assert (desk.asked(), desk.stops(), desk.driven()) == ([], [], [])


def test_an_emergency_stop_needs_no_deadman_and_no_status(desk):
    desk.show(SupervisorState.READY, boot_id="")
    desk.press(ESTOP)
    assert desk.stops() == [RequestKind.ESTOP]


def test_another_run_of_the_car_gets_a_lease_of_its_own(held):
    held.wait(0.1)
    held.driven()
    for boot_id, seen in (("6", {6}), ("", set())):
        held.show(SupervisorState.READY, boot_id=boot_id)
        held.wait(0.1)
        assert {c.boot_id for c in held.driven()} == seen
