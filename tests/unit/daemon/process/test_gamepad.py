"""Gamepads: the kernel's bytes from a pipe or a virtual device, and what they send on the bus."""

import os
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process import gamepad
from steerd.daemon.process.bus_operator import CarView
from steerd.daemon.process.gamepad import ABS, AXES, BUTTONS, KEY, PadEvent, PadMap, PadState
from steerd.daemon.process.teleop import PERIOD_NS, VALID_MS, Teleop
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import DriveCommand, OperatorRequest, RequestKind
from steerd.steer_bus.topics import make_key
from tests.local_bus import LocalBus, LocalHub

RECORDED = struct.pack("qqHHi" * 2, 1700000000, 5, KEY, 310, 1, 1700000000, 9, ABS, 0, -32768)
"""Two events as `cat /dev/input/event5` writes them on a 64-bit machine."""


@pytest.mark.parametrize("cut", [1, 23, 24, 25, 47, 48])
def test_bytes_of_the_kernel_are_events_wherever_they_are_cut(pipe, cut):
    pad, write_fd = gamepad.Pad("a pipe", pipe[0]), pipe[1]
    os.write(write_fd, RECORDED[:cut])
    events = pad.read()
    os.write(write_fd, RECORDED[cut:] + RECORDED)
    os.close(write_fd)
    assert events + pad.read() == [PadEvent(KEY, 310, 1), PadEvent(ABS, 0, -32768)] * 2
    with pytest.raises(gamepad.PadGoneError, match="a pipe"):
        pad.read()


def test_a_device_that_is_not_there_is_named_and_none_gets_advice(tmp_path, monkeypatch):
    with pytest.raises(SteerdError, match="event9: No such file"):
        gamepad.open_pad(tmp_path / "event9", BUTTONS["tl"])
    monkeypatch.setattr(gamepad, "FOLDER", tmp_path)
    with pytest.raises(SteerdError, match="no gamepad") as caught:
        gamepad.find_pad(BUTTONS["tl"])
    assert caught.value.code is ExitCode.UNREADABLE
    assert "--device" in caught.value.hint


@pytest.mark.skipif(not os.access("/dev/uinput", os.W_OK), reason="no /dev/uinput on this machine")
def test_a_virtual_gamepad_is_read_and_its_end_is_noticed():
    import evdev  # noqa: TID251

    axes = [(0, evdev.AbsInfo(0, -100, 100, 0, 3, 0)), (5, evdev.AbsInfo(0, 0, 255, 0, 0, 0))]
    made = evdev.UInput({KEY: [310, 315], ABS: axes}, name="steerd test pad")
    pad = gamepad.open_pad(Path(made.device.path), 310)
    assert pad.axes[0] == (-100, 100, 3)
    made.write(KEY, 310, 1)
    made.syn()
    assert PadEvent(KEY, 310, 1) in pad.read()
    made.close()
    with pytest.raises(gamepad.PadGoneError):
        for _ in iter(pad.read, None):
            pass
    pad.close()


# What a gamepad's parts mean, and everything that counts as letting go of it.
HELD = PadState(held=True, steer=0.5, speed=0.5)
STICK, TRIGGER = gamepad.AxisRange(-100, 100), gamepad.AxisRange(0, 200)
COARSE = gamepad.AxisRange(-100, 100, 20)


def moved(axis, value, **pads):
    """A held pad after this of one axis."""
    event = PadEvent(ABS, AXES[axis], value)
    return gamepad.take_event(HELD, event, PadMap(**pads), gamepad.XBOX_AXES, 7)[0]


def test_left_is_left_and_forward_is_forward():
    assert [moved("x", value).steer for value in (-32768, 32767)] == pytest.approx([1.0, -1.0])
    assert [moved("rz", value).speed for value in (1023, 0)] == [1.0, 0.0]
    stick = [moved("y", value, speed="y").speed for value in (-32768, 32767)]
    assert stick == pytest.approx([1.0, 0.0]), "there is no reverse"
    assert moved("ry", 9000) == replace(HELD, heard_ns=7)


@pytest.mark.parametrize(("value", "span", "name", "share"), [
    (0, STICK, "x", 0.0), (5, STICK, "x", 0.0), (-5, STICK, "x", 0.0), (100, STICK, "x", 1.0),
    (-100, STICK, "x", -1.0), (999, STICK, "x", 1.0), (-999, STICK, "x", -1.0),
    (20, COARSE, "x", 0.0), (60, COARSE, "x", 0.5), (0, TRIGGER, "rz", 0.0),
    (100, TRIGGER, "rz", 0.5), (300, TRIGGER, "rz", 1.0), (0, gamepad.AxisRange(0, 0), "rz", 0),
])  # fmt: skip
def test_an_axis_is_a_share(value, span, name, share):
    assert gamepad.read_axis(value, span, name) == pytest.approx(share)


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
        self.teleop = Teleop(self.view, PadMap(**pads), gamepad.XBOX_AXES)
        self.show(SupervisorState.READY)

    def show(self, state, boot_id=5):
        self.view.state = SimpleNamespace(mode=int(state))
        self.view.boot_id = boot_id

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


desk = pytest.fixture(lambda: Desk())


@pytest.fixture
def held(desk):
    """A desk whose deadman is held."""
    desk.press(DEADMAN)
    return desk


def test_nothing_is_sent_while_nobody_holds_the_deadman(desk):
    desk.press(BUTTONS["tr"])
    desk.move("rz", 1023)
    desk.press(GO)
    assert desk.wait(1.0) == []
    assert (desk.asked(), desk.driven()) == ([], [])


def test_who_holds_it_is_operator_and_controller(held):
    held.press(DEADMAN, 2)  # the kernel repeats a held key
    held.teleop.take([PadEvent(gamepad.SYN, 0, 0)])
    held.wait(1.0)
    assert held.asked().count(RequestKind.KEEPALIVE) >= 16, "twenty a second, in steps of 20 ms"
    commands = held.driven()
    assert len(commands) == 50
    assert {(c.boot_id, c.valid_ms) for c in commands} == {(5, VALID_MS)}
    assert len({c.lease_id for c in commands}) == 1
    assert [c.seq for c in commands] == list(range(commands[0].seq, commands[0].seq + 50))


def test_start_arms_a_ready_car_and_starts_an_armed_one(held):
    for value in (1, 2, 0):
        held.press(GO, value)
    held.press(BUTTONS["north"])
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
    desk.move("x", 0)
    assert desk.wait(2.0) == [], "not before its time"
    assert "no event of the gamepad for 2 s" in desk.wait(0.02)[0]


RELEASES = {
    "by hand": lambda desk: desk.press(DEADMAN, 0), "by silence": fall_silent,
    "by lost events": lambda d: d.teleop.take([PadEvent(gamepad.SYN, gamepad.SYN_DROPPED, 0)]),
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
    desk.show(SupervisorState.READY, boot_id=0)
    desk.press(ESTOP)
    assert desk.stops() == [RequestKind.ESTOP]


def test_another_run_of_the_car_gets_a_lease_of_its_own(held):
    held.wait(0.1)
    held.driven()
    for boot_id, seen in ((6, {6}), (0, set())):
        held.show(SupervisorState.READY, boot_id=boot_id)
        held.wait(0.1)
        assert {c.boot_id for c in held.driven()} == seen
