"""`steerd probe`: each thing that is wrong is named, with what to do; what is right is not."""

from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

from steerd.daemon.cli.commands.probe import format_found
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.setup import probe, probe_ask
from steerd.daemon.setup.mocap_check import Movement, check_movement
from steerd.mocap_link.frame import FrameConfig, make_body_pose, make_planar_pose
from steerd.mocap_link.gates import REASONS
from steerd.mocap_link.source import SourceState, SourceStatus

GOOD = probe.VescFound((6, 5), "60_MK6", "ab" * 12, 150, 20.0, 11.8, "", 25.0, 1.5, 1.0, True)
SEEN = probe.MocapSeen(
    "natnet://h/car", "Motive NatNet 4.1", ("car",), "streaming", 3.0, 300, 300, 100.0, 100.0,
    "echo", 0.1, 6.0, 1.0, 0.1, 0.01,
)  # fmt: skip


def fixes(advice):
    return " | ".join(f"{a.what} -> {a.fix}" for a in advice)


def test_of_what_is_sound_nothing_is_said_but_what_no_vesc_reports():
    (advice,) = probe.judge_vesc(GOOD, BrakeSettings())
    assert advice.what.startswith("the VESC does not report whether its servo output is on:")
    assert list(probe.judge_mocap(SEEN, named=True)) == []
    assert list(probe.judge_mocap(replace(SEEN, samples=0), named=False)) == []
    rare = replace(SEEN, refused=(("jump", 2),))
    assert list(probe.judge_mocap(rare, named=True)) == []


@pytest.mark.parametrize(("change", "said"), [
    ({"timeout_ms": 0}, "set Timeout to 100-200 ms in VESC Tool: App Settings > General"),
    ({"timeout_ms": 1000}, "the VESC's timeout is 1000 ms"),
    ({"timeout_brake_a": 0.0}, "set Timeout Brake Current above 0 A"),
    ({"timeout_ms": None}, "update its firmware"), ({"firmware": (3, 62)}, "'servoout' build"),
    ({"fault": "UNDER_VOLTAGE"}, "UNDER_VOLTAGE -> VESC Tool"),
    ({"voltage": 9.5}, "the battery is at 9.5 V, 3 cells -> charge it"),
    ({"round_trip_ms": 40.0}, "answers take 40.0 ms"), ({"answered": 0.5}, "50% of them arrive"),
])  # fmt: skip
def test_what_is_wrong_with_a_vesc(change, said):
    assert said in fixes(probe.judge_vesc(replace(GOOD, **change), BrakeSettings()))


@pytest.mark.parametrize(("change", "said"), [
    ({"server": "", "samples": 0, "detail": "silence"}, "no answer: silence"),
    ({"samples": 0}, "the server offers car: name one of them"),
    ({"samples": 0, "bodies": ()}, "interface=ADDRESS"),
    ({"rate_hz": 60.0}, "60 of 100 frames per second arrive -> use a cable"),
    ({"jitter_ms": 30.0}, "varies by 30 ms"),
    ({"refused": (("units", 300),)}, 'units -> set [mocap] units = "mm"'),
    ({"refused": (("jump", 300),)}, f"jump -> {REASONS['jump']}"), ({"tilt": 0.5}, "leans by 29°"),
])  # fmt: skip
def test_what_is_wrong_with_a_source(change, said):
    assert said in fixes(probe.judge_mocap(replace(SEEN, **change), named=True))


TCP = """  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid
   0: 0100007F:1D17 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 1
   1: 0100007F:1D17 0100007F:9C40 01 00000000:00000000 00:00000000 00000000     0        0 2
   2: 00000000:0016 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 3
"""


def test_sockets_of_this_machine(tmp_path):
    (tmp_path / "tcp").write_text(TCP)
    udp = TCP.replace("0100007F:1D17", "00000000000000000000000000000000:05E6")
    (tmp_path / "udp6").write_text(udp)
    found = probe_ask.find_sockets(tmp_path)
    both = [(s.kind, s.address, s.port) for s in found]
    assert both == [("tcp", "127.0.0.1", 7447), ("udp", "::", 1510)]
    assert "zenoh" in "\n".join(format_found(probe.Found((), (), found, True)))


def test_ports_by_their_usb_ids(tmp_path):
    dev, sysfs = tmp_path / "dev", tmp_path / "sys"
    dev.mkdir()
    for name, ids in (("ttyACM0", ("0483", "5740")), ("ttyUSB1", ("10c4", "ea60"))):
        (dev / name).touch()
        usb = tmp_path / "devices" / name
        (usb / "1:1.0").mkdir(parents=True)
        for key, value in zip(("idVendor", "idProduct"), ids, strict=True):
            (usb / key).write_text(value + "\n")
        (sysfs / name).mkdir(parents=True)
        (sysfs / name / "device").symlink_to(usb / "1:1.0")
    (dev / "ttyACM7").touch()
    (dev / "ttyS0").touch()
    found = {"ttyACM0": "0483:5740", "ttyACM7": "", "ttyUSB1": "10c4:ea60"}
    assert probe_ask.find_ports(dev, sysfs) == {str(dev / port): found[port] for port in found}


# `steerd mocap check`: a sound room passes, each wrong axis or unit is named with its remedy.
ROOM = FrameConfig(up="y", body_forward="+z")


def movement(seen_by=ROOM, *, straight=True, length=1.0):
    """A push (or a figure of eight) through a room as it is, seen with a configuration."""
    s = np.linspace(0.0, length if straight else 8.0, 400)
    yaw = 0.4 + (0.0 * s if straight else np.cumsum(0.8 * np.sin(s)) * (s[1] - s[0]))
    places = np.array([np.cumsum(f(yaw)) * (s[1] - s[0]) for f in (np.cos, np.sin)] + [yaw])
    places += np.array([[4e-4], [4e-4], [2e-3]]) * np.random.default_rng(0).normal(size=(3, len(s)))
    rows = []
    for i, place in enumerate(places.T):
        p = make_planar_pose(seen_by, *make_body_pose(ROOM, *place, 0.1))
        rows.append((0.01 * i, p.x, p.y, p.yaw, p.height, p.tilt))
    return Movement(*np.array(rows).T)


def failed(m, refused=0):
    return {c.name: c.fix for c in check_movement(m, refused) if not c.ok}


@pytest.mark.parametrize("straight", [True, False])
def test_a_sound_room_passes_and_a_car_that_is_not_seen_is_a_case_for_probe(straight):
    seen = movement(straight=straight)
    checks = check_movement(seen, 0)
    assert [c.name for c in checks if not c.ok] == []
    assert len(checks) == (5 if straight else 6)
    assert "probe" in failed(seen, refused=100)["stream"]


PUSHED, EIGHT = movement(), movement(straight=False)
WRONG = [
    (movement(replace(ROOM, up="z", body_forward="+x")), "height", "[mocap] up"),
    (movement(replace(ROOM, body_forward="+x")), "heading", "90°"),
    (movement(replace(ROOM, body_forward="-x")), "heading", "90°"),
    (movement(replace(ROOM, body_forward="-z")), "heading", "turn [mocap] body_forward round"),
    (movement(replace(ROOM, mount_yaw=0.2)), "heading", "steerd mocap calibrate"),
    (replace(EIGHT, y=-EIGHT.y), "turning", "mirrored"),
    (movement(length=0.1), "distance", "push the car"),
    (replace(PUSHED, tilt=PUSHED.tilt + 0.2), "level", "orientation"),
    (replace(PUSHED, x=1e4 * PUSHED.x, y=1e4 * PUSHED.y), "distance", "millimetres"),
]


@pytest.mark.parametrize(("moved", "check", "said"), WRONG, ids=[row[2] for row in WRONG])
def test_a_wrong_axis_unit_or_body_is_named_with_its_remedy(moved, check, said):
    wrong = failed(moved)
    assert said in wrong[check]
    assert check != "heading" or len(wrong) == 1


DEAF = SimpleNamespace(  # a receiver whose server never answers
    fds=list, on_timer=lambda now_ns: [], close=lambda: None,
    status=lambda: SourceStatus(SourceState.CONNECTING, "no answer for 3 s"),
)  # fmt: skip


def test_nobody_pushes_for_a_source_that_does_not_answer(monkeypatch, cli):
    looks = count(1)  # at a clock that is a second later at each
    clock = SimpleNamespace(now_ns=lambda: next(looks) * 1_000_000_000)
    monkeypatch.setattr(probe_ask, "make_receiver", lambda url, config: DEAF)
    monkeypatch.setattr(probe_ask, "MonotonicClock", lambda: clock)
    line = ["mocap", "check", "--mocap", "natnet://192.0.2.1/car", "--seconds", "60"]
    said = cli(*line, code=ExitCode.UNREADABLE).err
    assert "no answer for 3 s" in said
    assert "push" not in said
    assert 1 < next(looks) <= 20, "given up long before the 60 s"
