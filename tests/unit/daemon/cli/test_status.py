"""`steerd status` on a terminal of 80 columns."""

import pytest

from steerd.daemon.cli.commands.driving.status import format_status

STATUS = {
    "state": "DISARMED",
    "reason": "start",
    "waiting": "an operator: steerd arm",
    "warnings": "",
    "firmware": "6.05",
    "uuid": "ab" * 12,
    "vesc_timeout_ms": "150",
    "mocap": "natnet streaming",
    "mocap_rate_hz": "240",
    "controller": "lane",
}


def test_one_line_for_each_fact():
    assert format_status("car1", STATUS) == [
        "car1: DISARMED — start",
        "waiting for: an operator: steerd arm",
        "VESC:        firmware 6.05, timeout 150 ms",
        "UUID:        abababababababababababab",
        "mocap:       natnet streaming, 240 Hz",
        "controller:  lane",
    ]


def test_each_warning_has_a_line_of_its_own():
    lines = format_status("car1", STATUS | {"warnings": "no fixed priority\n\nlow battery"})
    assert lines[2:4] == ["warning:     no fixed priority", "warning:     low battery"]


def test_a_daemon_without_a_vesc_or_mocap_has_a_status_too():
    bare = {"state": "INIT", "reason": "start", "waiting": "the serial port"}
    assert "VESC:        firmware ?, timeout ? ms" in format_status("blue", bare)


@pytest.mark.parametrize(
    ("design", "why", "line"),
    [("learnt 3", "", "design:      learnt 3"),
     ("car file", "the learner is silent", "design:      car file (the learner is silent)")],
)  # fmt: skip
def test_the_design_that_steers_is_named_with_its_reason(design, why, line):
    assert line in format_status("car1", {**STATUS, "design": design, "design_why": why})
