"""`steerd info`: known drives, on a terminal and as JSON; checks of units, signs and axes."""

import json
import math

import numpy as np
import pytest

from steerd.daemon.common.screen import WARNINGS_SHOWN, print_warnings
from steerd.daemon.imports.import_session import MessageMaker
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions import motion
from steerd.daemon.sessions.info import load_recording, make_session_report, seconds_since
from steerd.daemon.sessions.motion import find_implausible, make_track
from steerd.daemon.sessions.text import format_report, make_json
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, Transition, make_header
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.topics import ACTUATION, MOCAP, TRANSITION, WHEEL, make_session_topic
from steerd.sysid.data.dataset import Signal

EPOCH = 1_726_480_861_000_000_000
RADIUS, SPEED = 2.0, 1.5


def circle(count=1000, dt=0.01, *, noise=0.0, seed=1):
    t = np.arange(count) * dt
    yaw = SPEED / RADIUS * t
    x, y = RADIUS * np.sin(yaw), RADIUS * (1 - np.cos(yaw))
    rng = np.random.default_rng(seed)
    return t, x + noise * rng.normal(size=count), y + noise * rng.normal(size=count), yaw


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


def test_a_known_circle_is_described_as_it_was_and_json_has_no_numbers_that_it_lacks(tmp_path):
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
    document = make_json(report)
    again = json.loads(json.dumps(document, allow_nan=False))
    assert again["schema"] == "steerd.info/1"
    assert again["drive"]["length_m"] == pytest.approx(SPEED * 9.99, rel=2e-3)
    assert again["states"][1]["state"] == "DISARMED"
    assert again["metadata"]["steerd.end"]["dropped"] == "3"
    assert make_json(report_of(tmp_path / "a.mcap")) == document


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


# The motion of known drives; checks of units, signs and axes.
def test_noise_widens_the_window_and_the_length_stays_and_reversing_has_a_sign():
    for noise in (0.0, 3e-4, 0.02, 0.05):
        track = make_track(*circle(2000, noise=noise))
        assert track.length == pytest.approx(SPEED * 19.99, rel=0.03)
        assert track.coarse == (noise > 0.01)
    t, x, y, yaw = circle()
    track = make_track(t, x[::-1], y[::-1], yaw[::-1])
    assert np.nanmedian(track.speed) == pytest.approx(-SPEED, rel=1e-2)


def test_bad_poses_make_no_track_and_of_nothing_there_is_no_range_and_no_error():
    nan = np.full(5, np.nan)
    assert motion.make_range(nan) is None
    assert motion.make_range(np.empty(0)) is None
    assert np.isnan(motion.rms(np.empty(0)))
    five = np.arange(5.0)
    assert make_track(five, nan, five, five) is None
    assert make_track(np.zeros(5), five, five, five) is None
    assert make_track(five[:2], five[:2], five[:2], five[:2]) is None
    assert make_track(five, five * 1e300, five, five) is None
    shuffled = make_track(np.array([2.0, 0.0, 1.0, 1.0, 3.0]), five, five, five)
    assert shuffled.t.tolist() == [0.0, 1.0, 2.0, 3.0]


def warnings_for(*, pose=1.0, yaw=1.0, front=0.0, steer=1.0, wheel=1.0, gyro=1.0):
    t = np.arange(3000) * 0.01
    turn = 0.8 * np.sin(0.7 * t)
    heading = np.concatenate(([0.0], np.cumsum(turn[:-1] * 0.01)))
    x = np.cumsum(SPEED * np.cos(heading) * 0.01)
    y = np.cumsum(SPEED * np.sin(heading) * 0.01)
    late, angle = 0.15, np.arctan(0.33 * turn / SPEED)
    asked, rolled = Signal(t - late, steer * angle), Signal(t, wheel * np.full_like(t, SPEED))
    track = make_track(t, pose * x, pose * y, yaw * heading + front)
    return find_implausible(track, asked, rolled, Signal(t, gyro * turn))


def test_a_plausible_drive_raises_no_warning_and_checks_need_no_poses():
    assert warnings_for() == []
    assert warnings_for(wheel=1.15, gyro=0.95, steer=0.7) == []
    assert all("backwards" not in text for text in warnings_for(front=np.pi, wheel=-1.0))
    assert find_implausible(None, None, None, None) == []
    steer = Signal(np.arange(3.0), np.array([0.0, 20.0, -20.0]))
    assert len(find_implausible(None, steer, None, None)) == 1


@pytest.mark.parametrize(("wrong", "part"), [
    ({"pose": 1000.0, "wheel": 1000.0}, "millimetres"), ({"yaw": 57.3}, "is it in degrees"),
    ({"yaw": -1.0}, "clockwise"), ({"front": np.pi}, "backwards throughout"),
    ({"steer": -1.0}, "left positive"), ({"steer": 57.3}, "is it in degrees"),
    ({"wheel": 3.6}, "km/h"), ({"wheel": 1000.0}, "millimetres"), ({"wheel": 2.0}, "gear ratio"),
    ({"gyro": 57.3}, "degrees/s"), ({"gyro": -1.0}, "opposite sign"),
])  # fmt: skip
def test_a_wrong_unit_or_sign_is_named(wrong, part):
    found = warnings_for(**wrong)
    assert len(found) == 1
    assert part in found[0]


# The lateral error that pages and lists show: of a settled drive alone.
START_NS = 10**18
RUNNING = np.array([0, 1, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1], dtype=bool)


def test_each_start_settles_anew_and_errors_are_sizes_where_they_are_known():
    """One row a second; the error is the row's number in centimetres, to either side."""
    seconds = np.arange(len(RUNNING))
    t = seconds_since(START_NS, START_NS + seconds * 10**9)
    mode = np.where(RUNNING, int(SupervisorState.RUNNING), int(SupervisorState.ARMED))
    state = {"mode": mode, "e1": 0.01 * seconds * np.where(seconds % 2, -1.0, 1.0)}
    assert np.flatnonzero(motion.find_settled(state, t)).tolist() == [4, 5, 11]
    assert motion.SETTLE == 3.0
    state["e1"][5] = np.nan
    errors = motion.settled_errors(state, t)
    assert errors == pytest.approx([0.04, 0.11])
    assert motion.rms(errors) == pytest.approx(np.sqrt((0.04**2 + 0.11**2) / 2))
