"""`steerd probe`: each thing that is wrong is named, with what to do; what is right is not."""

from dataclasses import replace

import pytest

from steerd.daemon.settings.config import BrakeSettings
from steerd.daemon.setup.probe import (
    Advice,
    MocapSeen,
    SerialFound,
    VescFound,
    judge_mocap,
    judge_vesc,
    read_sockets,
)
from steerd.daemon.setup.probe_ask import find_ports, find_sockets
from steerd.daemon.setup.probe_text import format_mocap, format_serial, format_sockets
from steerd.mocap_link.gates import REASONS

GOOD = VescFound((6, 5), "60_MK6", "ab" * 12, 150, 20.0, 11.8, "", 25.0, 1.5, 1.0, True)
SEEN = MocapSeen(
    "natnet://h/car", "Motive NatNet 4.1", ("car",), "streaming", 3.0, 300, 300, 100.0, 100.0,
    "echo", 0.1, 6.0, 1.0, 0.1, 0.01,
)  # fmt: skip


def fixes(advice):
    return " | ".join(f"{a.what} -> {a.fix}" for a in advice)


def test_a_sound_vesc_leaves_only_what_no_vesc_reports():
    assert [a.what.split(":")[0] for a in judge_vesc(GOOD, BrakeSettings())] == [
        "the VESC does not report whether its servo output is on"
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"timeout_ms": 0}, "set Timeout to 100-200 ms in VESC Tool: App Settings > General"),
        ({"timeout_ms": 1000}, "the VESC's timeout is 1000 ms"),
        ({"timeout_brake_a": 0.0}, "set Timeout Brake Current above 0 A"),
        ({"timeout_ms": None}, "update its firmware"),
        ({"firmware": (3, 62)}, "'servoout' build"),
        ({"fault": "UNDER_VOLTAGE"}, "UNDER_VOLTAGE -> VESC Tool"),
        ({"voltage": 9.5}, "the battery is at 9.5 V, 3 cells -> charge it"),
        ({"round_trip_ms": 40.0}, "answers take 40.0 ms"),
        ({"answered": 0.5}, "50% of them arrive"),
    ],
)
def test_what_is_wrong_with_a_vesc(change, said):
    assert said in fixes(judge_vesc(replace(GOOD, **change), BrakeSettings()))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"server": "", "samples": 0, "detail": "silence"}, "no answer: silence"),
        ({"samples": 0}, "the server offers car: name one of them"),
        ({"samples": 0, "bodies": ()}, "interface=ADDRESS"),
        ({"rate_hz": 60.0}, "60 of 100 frames per second arrive -> use a cable"),
        ({"jitter_ms": 30.0}, "varies by 30 ms"),
        ({"refused": (("units", 300),)}, 'units -> set [mocap] units = "mm"'),
        ({"refused": (("jump", 300),)}, f"jump -> {REASONS['jump']}"),
        ({"tilt": 0.5}, "leans by 29°"),
    ],
)
def test_what_is_wrong_with_a_source(change, said):
    assert said in fixes(judge_mocap(replace(SEEN, **change), named=True))


def test_a_sound_source_and_a_server_without_a_named_body():
    assert list(judge_mocap(SEEN, named=True)) == []
    assert list(judge_mocap(replace(SEEN, samples=0), named=False)) == []
    rare = replace(SEEN, refused=(("jump", 2),))
    assert list(judge_mocap(rare, named=True)) == []


TCP = """  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid
   0: 0100007F:1D17 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 1
   1: 0100007F:1D17 0100007F:9C40 01 00000000:00000000 00:00000000 00000000     0        0 2
   2: 00000000:0016 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 3
"""


def test_sockets_of_this_machine(tmp_path):
    found = list(read_sockets(TCP, "tcp"))
    assert [(s.kind, s.address, s.port) for s in found] == [("tcp", "127.0.0.1", 7447)]
    assert list(read_sockets(TCP, "udp")) == []
    (tmp_path / "tcp").write_text(TCP)
    (tmp_path / "udp6").write_text(
        TCP.replace("0100007F:1D17", "00000000000000000000000000000000:05E6")
    )
    assert [(s.kind, s.port) for s in find_sockets(tmp_path)] == [("tcp", 7447), ("udp", 1510)]
    assert "zenoh" in "\n".join(format_sockets(found))


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
    assert find_ports(dev, sysfs) == {
        str(dev / "ttyACM0"): "0483:5740",
        str(dev / "ttyACM7"): "",
        str(dev / "ttyUSB1"): "10c4:ea60",
    }


def test_the_text_names_the_udev_file_and_fits_80_columns():
    bad = replace(GOOD, timeout_ms=0, fault="ABS_OVER_CURRENT", voltage=9.0)
    advice = tuple(judge_vesc(bad, BrakeSettings()))
    advice += (Advice("it is busy", f"{'close what uses it, ' * 8}\n  to copy: {'x' * 50}"),)
    lines = list(format_serial([SerialFound("/dev/ttyACM0", "0483:5740", bad, advice)], False))
    text = "\n".join(lines)
    assert "timeout   never, then 20 A" in text
    assert "sudo usermod -aG dialout" in text
    assert max(map(len, lines)) <= 80
    assert f"          to copy: {'x' * 50}" in lines
    assert "    steerd service udev | sudo tee /etc/udev/rules.d/99-vesc.rules" in lines
    shown = "\n".join(format_mocap([(SEEN, tuple(judge_mocap(SEEN, named=True)))]))
    assert "100 of 100 Hz, 300 of 300 accepted" in shown
    assert "!" not in shown
