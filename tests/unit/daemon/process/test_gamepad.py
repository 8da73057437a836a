"""Gamepads as the kernel's bytes: from a pipe, and from a virtual device where one can be made."""

import os
import struct
from pathlib import Path

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.process import gamepad
from steerd.daemon.process.gamepad import (
    ABS,
    KEY,
    DevicePad,
    PadEvent,
    PadGoneError,
    StreamPad,
    find_pad,
    open_pad,
)
from steerd.daemon.process.pad_map import BUTTONS

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
