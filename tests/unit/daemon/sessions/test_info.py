"""`steerd info`: a drive of known motion is summarised, on a terminal and as JSON."""

import json
import math

import pytest

from steerd.daemon.common.screen import WARNINGS_SHOWN, print_warnings
from steerd.daemon.imports.import_session import MessageMaker
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.info import load_recording, make_session_report
from steerd.daemon.sessions.text import format_report, make_json
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, Transition, make_header
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.topics import ACTUATION, MOCAP, TRANSITION, WHEEL, make_session_topic
from tests.unit.daemon.sessions.test_motion import RADIUS, SPEED, circle

EPOCH = 1_726_480_861_000_000_000


def write_circle(path, *, gap=False):
    recorded = (MOCAP, ACTUATION, TRANSITION, WHEEL)
    topics = {make_session_topic("blue", topic): topic.message for topic in recorded}
    metadata = {"steerd.session": {"car": "blue", "mode": "hw", "comment": "tyres cold"}}
    writer = SessionWriter(path, topics, metadata)
    maker = MessageMaker(EPOCH)
    for i, (t, x, y, yaw) in enumerate(zip(*circle(), strict=True)):
        t_ns = round(t * 1e9)
        if i % 100 == 0 and i < 700:
            states = (SupervisorState(i // 100), SupervisorState(i // 100 + 1))
            message = Transition(make_header(t_ns + EPOCH, BODY), *states, "code", "because")
            writer.write("/steerd/blue/transition", encode(message), t_ns + EPOCH)
        if gap and 300 <= i < 350:
            continue
        pose = maker.planar_pose(t_ns, x, y, yaw)
        writer.write("/steerd/blue/mocap", encode(pose), t_ns + EPOCH)
        command = maker.command(t_ns, 0.2 * math.sin(5 * t), SPEED)
        writer.write("/steerd/blue/actuation", encode(command), t_ns + EPOCH)
    return writer.finish({"reason": "end of the run", "dropped": "3"})


def report_of(path):
    return make_session_report(load_recording(path))


def test_a_known_circle_is_described_as_it_was(tmp_path):
    report = report_of(write_circle(tmp_path / "a.mcap"))
    assert (report.car, report.mode, report.end) == ("blue", "hw", "end of the run")
    assert report.length_m == pytest.approx(SPEED * 9.99, rel=2e-3)
    assert (report.speed.low, report.speed.high) == pytest.approx((SPEED, SPEED), rel=2e-3)
    assert report.lateral_accel.high == pytest.approx(SPEED**2 / RADIUS, rel=2e-3)
    assert report.steer.high == pytest.approx(0.2, rel=1e-3)
    assert report.excitation == ("speed is constant: drive lag and delay are not identifiable",)
    assert [s.state for s in report.states] == [SupervisorState(i).name for i in range(8)]
    assert [s.t_s for s in report.states] == pytest.approx([0.0, *range(7)])
    counts = {t.name.rpartition("/")[2]: (t.count, t.gaps) for t in report.topics}
    assert counts == {"mocap": (1000, 0), "actuation": (1000, 0), "transition": (7, None)}
    assert all(t.name.startswith("/steerd/blue/") for t in report.topics)
    assert report.topics[0].rate_hz == pytest.approx(100.0)
    assert (report.empty_topics, report.warnings) == (("/steerd/blue/wheel",), ())


def test_gaps_are_found_and_it_fits_a_screen(tmp_path):
    report = report_of(write_circle(tmp_path / "a.mcap", gap=True))
    mocap = report.topics[0]
    assert (mocap.gaps, mocap.longest_gap_s) == (1, pytest.approx(0.51))
    assert mocap.longest_gap_at_s == pytest.approx(2.99)
    assert report.length_m == pytest.approx(SPEED * 9.99, rel=0.01)
    lines = format_report(report).splitlines()
    assert len(lines) < 24
    assert max(map(len, lines)) <= 80
    for said in (
        "blue, on the car", "tyres cold", "2024-09-16 10:01:01 UTC, 10.0 s", "3 messages dropped",
        "init → disarmed 0.0 → ready 1.0", "100.0 Hz  1, worst 0.51 s at 3.0 s",
    ):  # fmt: skip
        assert said in "\n".join(lines)


def test_json_has_no_numbers_that_json_lacks(tmp_path):
    document = make_json(report_of(write_circle(tmp_path / "a.mcap")))
    again = json.loads(json.dumps(document, allow_nan=False))
    assert again["schema"] == "steerd.info/1"
    assert again["drive"]["length_m"] == pytest.approx(SPEED * 9.99, rel=2e-3)
    assert again["states"][1]["state"] == "DISARMED"
    assert again["metadata"]["steerd.end"]["dropped"] == "3"
    assert make_json(report_of(tmp_path / "a.mcap")) == document


# A report fits a terminal of 80 columns and breaks no word.
def test_texts_of_a_file_reach_no_terminal_as_control_codes(tmp_path):
    path = tmp_path / "a.mcap"
    about = {"steerd.session": {"car": "\x1b]0;x\a"}}
    writer = SessionWriter(path, {"/\x1b[31m": Transition}, about)
    writer.write("/\x1b[31m", encode(Transition(make_header(0, BODY), 99, 98, "", "\x1b")), 0)
    writer.finish({"reason": "\x1b[2J"})
    assert "\x1b" not in format_report(make_session_report(load_recording(path)))


def test_many_warnings_are_counted(capsys):
    print_warnings([f"number {i}" for i in range(WARNINGS_SHOWN + 3)])
    lines = capsys.readouterr().err.splitlines()
    assert (lines[0], lines[-1]) == ("warning: number 0", "warning: and 3 more")
    assert len(lines) == WARNINGS_SHOWN + 1
