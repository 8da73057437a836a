"""A session's report fits a terminal of 80 columns and breaks no word."""

from dataclasses import replace

import pytest

from steerd.daemon.sessions.info import (
    SessionReport,
    StateChange,
    TopicReport,
    load_recording,
    make_session_report,
)
from steerd.daemon.sessions.motion import SignalRange
from steerd.daemon.sessions.text import WARNINGS_SHOWN, format_report, print_warnings
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, Transition, make_header
from steerd.steer_bus.session import SessionWriter

NAMES = ("INIT", "DISARMED", "READY", "SELF_TEST", "ARMED", "RUNNING", "FAULT_STOP") * 2


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> SessionReport:
    path = tmp_path_factory.mktemp("text") / "a-drive-with-a-rather-long-name-2024-09-16.mcap"
    writer = SessionWriter(path, {"/steerd/car1/transition": Transition}, {"steerd.session": {}})
    writer.finish({"reason": "watchdog W12 stopped the car: lateral error above its limit " * 2})
    return replace(
        make_session_report(load_recording(path)),
        states=tuple(StateChange(1234.5 * i, name, "") for i, name in enumerate(NAMES)),
        length_m=12345.6,
        speed=SignalRange(-10.0, 10.0, 1.0),
        steer=SignalRange(-0.41, 0.41, 0.22),
        lateral_accel=SignalRange(-10.0, 9.0, 1.0),
        excitation=("lateral acceleration stays below 1 m/s²: tyre parameters, all of them, are "
                    "not identifiable",),
        topics=(
            TopicReport("/steerd/car1/state", "steerd/msg/State", 1_234_567, 100.0, 0, 0.0, 0.0),
            TopicReport("/vrpn_client_node/the_car_in_the_hall/pose", "geometry_msgs/PoseStamped",
                        123_456, 240.0, 12, 0.123, 12345.6),
        ),
        empty_topics=tuple(f"/camera/topic_number_{i}" for i in range(20)),
    )  # fmt: skip


def test_no_line_is_wider_than_80_columns(report):
    lines = format_report(report).splitlines()
    assert len(lines) > 12
    assert [line for line in lines if len(line) > 80] == []


def test_a_name_that_does_not_fit_ends_in_an_ellipsis_and_columns_stay_aligned(report):
    head, *rows = [line for line in format_report(report).splitlines() if "Hz" in line or
                   line.startswith("  topic")]  # fmt: skip
    assert [row.index("Hz") for row in rows] == [head.index("rate") + 2] * 2
    assert rows[1].startswith("  /vrpn_client_nod…  PoseS…")


def test_texts_of_a_file_reach_no_terminal_as_control_codes(tmp_path):
    path = tmp_path / "a.mcap"
    writer = SessionWriter(
        path, {"/\x1b[31m": Transition}, {"steerd.session": {"car": "\x1b]0;x\a"}}
    )
    writer.write("/\x1b[31m", encode(Transition(make_header(0, BODY), 99, 98, "", "\x1b")), 0)
    writer.finish({"reason": "\x1b[2J"})
    assert "\x1b" not in format_report(make_session_report(load_recording(path)))


def test_many_warnings_are_counted(capsys):
    print_warnings([f"number {i}" for i in range(WARNINGS_SHOWN + 3)])
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "warning: number 0"
    assert lines[-1] == "warning: and 3 more"
    assert len(lines) == WARNINGS_SHOWN + 1
