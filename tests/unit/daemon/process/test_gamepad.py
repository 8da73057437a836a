"""Gamepads as the kernel's bytes: from a pipe, and from a virtual device where one can be made."""

import os
import struct
from pathlib import Path

import pytest
from steerd.daemon.process.gamepad import (
    ABS,
    AXES,
    BUTTONS,
    KEY,
    SYN,
    SYN_DROPPED,
    XBOX_AXES,
    AxisRange,
    DevicePad,
    PadEvent,
    PadGoneError,
    PadMap,
    PadState,
    StreamPad,
    find_pad,
    is_silent,
    open_pad,
    read_axis,
    take_event,
)

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.process import gamepad

RECORDED = struct.pack("qqHHi", 1700000000, 5, KEY, 310, 1) + struct.pack(
    "qqHHi", 1700000000, 9, ABS, 0, -32768
)
"""Two events as `cat /dev/input/event5` writes them on a 64-bit machine."""


@pytest.fixture
def pipe():
    read_fd, write_fd = os.pipe()
    pad = StreamPad("a pipe", read_fd)
    yield pad, write_fd
    pad.close()


def read_to_the_end(pad):
    while True:
        pad.read()


def test_bytes_of_the_kernel_are_events(pipe):
    pad, write_fd = pipe
    os.write(write_fd, RECORDED)
    os.close(write_fd)
    assert pad.read() == [PadEvent(KEY, 310, 1), PadEvent(ABS, 0, -32768)]
    with pytest.raises(PadGoneError, match="a pipe"):
        pad.read()


@pytest.mark.parametrize("cut", [1, 23, 24, 25, 47])
def test_events_cut_anywhere_come_whole(pipe, cut):
    pad, write_fd = pipe
    os.write(write_fd, RECORDED[:cut])
    events = pad.read()
    os.write(write_fd, RECORDED[cut:])
    os.close(write_fd)
    assert events + pad.read() == [PadEvent(KEY, 310, 1), PadEvent(ABS, 0, -32768)]


def test_a_device_that_is_not_there_is_named(tmp_path):
    with pytest.raises(SteerdError, match="event9: No such file"):
        open_pad(tmp_path / "event9", BUTTONS["tl"])


def test_no_gamepad_is_an_error_with_advice(tmp_path, monkeypatch):
    monkeypatch.setattr(gamepad, "FOLDER", tmp_path)
    with pytest.raises(SteerdError, match="no gamepad") as caught:
        find_pad(BUTTONS["tl"])
    assert caught.value.code is ExitCode.UNREADABLE
    assert "--device" in caught.value.hint


@pytest.mark.skipif(
    not os.access("/dev/uinput", os.W_OK), reason="no /dev/uinput: no virtual gamepad can be made"
)
def test_a_virtual_gamepad_is_read_and_its_end_is_noticed():
    import evdev  # noqa: TID251

    axes = [(0, evdev.AbsInfo(0, -100, 100, 0, 3, 0)), (5, evdev.AbsInfo(0, 0, 255, 0, 0, 0))]
    made = evdev.UInput({KEY: [310, 315], ABS: axes}, name="steerd test pad")
    pad = DevicePad(Path(made.device.path))
    assert pad.axes[0] == (-100, 100, 3)
    made.write(KEY, 310, 1)
    made.syn()
    assert PadEvent(KEY, 310, 1) in pad.read()
    made.close()
    with pytest.raises(PadGoneError):
        read_to_the_end(pad)
    pad.close()


# What a gamepad's parts mean, and everything that counts as letting go of it.

PADS = PadMap()
HELD = PadState(held=True, steer=0.5, speed=0.5, heard_ns=0)
STICK, TRIGGER = AxisRange(-100, 100), AxisRange(0, 200)


def after(*events, pads=PADS, start=HELD):
    """The state after events, and what was pressed."""
    pad, pressed = start, []
    for event in events:
        pad, code = take_event(pad, PadEvent(*event), pads, XBOX_AXES, 7)
        pressed += [] if code is None else [code]
    return pad, pressed


def test_the_deadman_is_held_from_its_press_to_its_release():
    assert after((KEY, PADS.deadman, 1), start=PadState())[0].held
    assert after((KEY, PADS.deadman, 2))[0].held, "the kernel repeats a held key"
    assert not after((KEY, PADS.deadman, 0))[0].held
    assert not after((KEY, BUTTONS["tr"], 1), start=PadState())[0].held


def test_lost_events_let_go():
    assert not after((SYN, SYN_DROPPED, 0))[0].held
    assert after((SYN, 0, 0))[0].held


def test_buttons_count_when_they_are_pressed():
    assert after((KEY, PADS.go, 1), (KEY, PADS.go, 2), (KEY, PADS.go, 0))[1] == [PADS.go]
    assert after((KEY, PADS.estop, 1), start=PadState())[1] == [PADS.estop], "without the deadman"
    assert after((KEY, BUTTONS["north"], 1))[1] == []


def test_left_is_left_and_forward_is_forward():
    assert after((ABS, AXES["x"], -32768))[0].steer == pytest.approx(1.0)
    assert after((ABS, AXES["x"], 32767))[0].steer == pytest.approx(-1.0)
    assert after((ABS, AXES["rz"], 1023))[0].speed == 1.0
    assert after((ABS, AXES["rz"], 0))[0].speed == 0.0
    stick = PadMap(speed="y")
    assert after((ABS, AXES["y"], -32768), pads=stick)[0].speed == pytest.approx(1.0)
    assert after((ABS, AXES["y"], 32767), pads=stick)[0].speed == 0.0, "there is no reverse"
    other = after((ABS, AXES["ry"], 9000))[0]
    assert (other.steer, other.speed) == (HELD.steer, HELD.speed)


@pytest.mark.parametrize(
    ("value", "span", "name", "share"),
    [
        (0, STICK, "x", 0.0), (5, STICK, "x", 0.0), (-5, STICK, "x", 0.0), (100, STICK, "x", 1.0),
        (-100, STICK, "x", -1.0), (999, STICK, "x", 1.0), (-999, STICK, "x", -1.0),
        (20, AxisRange(-100, 100, 20), "x", 0.0), (60, AxisRange(-100, 100, 20), "x", 0.5),
        (0, TRIGGER, "rz", 0.0), (100, TRIGGER, "rz", 0.5), (300, TRIGGER, "rz", 1.0),
        (0, AxisRange(0, 0), "rz", 0.0),
    ],
)  # fmt: skip
def test_an_axis_is_a_share(value, span, name, share):
    assert read_axis(value, span, name) == pytest.approx(share)


def test_a_held_pad_that_says_nothing_is_released_after_its_time_and_not_before():
    quiet = PADS.quiet_ns
    assert not is_silent(HELD, PADS, quiet)
    assert is_silent(HELD, PADS, quiet + 1)
    assert not is_silent(PadState(held=False), PADS, 10 * quiet)
    assert after((ABS, AXES["x"], 1))[0].heard_ns == 7
