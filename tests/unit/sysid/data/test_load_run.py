"""A recorded session becomes the drive that it was, on one clock."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from steerd.car_model.effects import find_effect
from steerd.car_model.ops import FLOAT
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.topics import ACTUATION, IMU, MOCAP, VESC, Topic, make_session_topic
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Signal, make_run, read_run
from steerd.sysid.data.jitter_correction import correct_log_jitter, find_log_jitter, log_period
from steerd.sysid.data.windows import remembered

EPOCH = 1_700_000_000_000_000_000
BOOT = 55_000_000_000
NAN = float("nan")


def _messages(t_ns: int, k: int) -> list[tuple[Topic, object]]:
    x, reject = 0.015 * k + (5.0 if k == 150 else 0.0), "jump" if k == 150 else ""
    header, world = (m.make_header(EPOCH + t_ns, frame) for frame in (m.BODY, m.WORLD))
    steer = 0.1 if k >= 100 else 0.0
    mode = m.ActuationMode.BRAKE if k < 20 else m.ActuationMode.SPEED
    yaw = (3.1 + 0.01 * k + np.pi) % (2 * np.pi) - np.pi
    times, raw = (t_ns, t_ns + 2_000_000, 0, 0, 0), (x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    pose = m.MocapPose(world, *times, 1, *raw, NAN, x, 0.5, yaw, 0.0, 0.0, reject)
    sent = (t_ns - 1_000_000, t_ns + 1_000_000)
    return [
        (MOCAP, pose),
        (ACTUATION, m.Actuation(header, k, mode, steer, 1.5, NAN, b"")),
        (VESC, m.VescTelemetry(header, *sent, -1, 9228, -1, -1, -1, -1, *(NAN,) * 10)),
        (IMU, m.VescImu(header, *sent, *(NAN,) * 5, 1.0, *(NAN,) * 4)),
    ]


def _record(path, *topics):
    """A drive of 4 s with messages of these topics."""
    scaling = {"erpm_gain": "4614", "erpm_offset": "0"}
    named = {make_session_topic("car", t): t.message for t in topics}
    writer = SessionWriter(path, named, {"steerd.scaling": scaling})
    for k in range(400):
        t_ns = BOOT + 10_000_000 * k
        for topic, message in _messages(t_ns, k):
            if topic in topics:
                writer.write(f"/steerd/car/{topic.name}", encode(message), EPOCH + t_ns)
    return open_session(writer.finish({"reason": "test"}))


def test_a_session_without_poses_says_what_to_do(tmp_path):
    with pytest.raises(DataError, match="no topic 'mocap'"):
        read_run(_record(tmp_path / "drive.mcap", ACTUATION))


def test_signals_share_the_commands_clock(tmp_path):
    run = read_run(_record(tmp_path / "drive.mcap", MOCAP, ACTUATION, VESC, IMU))
    assert (run.name, run.speed_source) == ("drive.mcap", "command")
    assert len(run.pose.t) == 379  # 20 before the drive, one rejected
    assert run.pose.t[:2] == pytest.approx([0.0, 0.01], abs=1e-9)
    assert run.pose.values[0] == pytest.approx([0.3, 0.5, 3.3], abs=1e-9)
    assert np.diff(run.pose.values[:, 2]).max() < 0.03
    assert (run.wheel.values, run.yaw_rate.values) == (pytest.approx(2.0), pytest.approx(1.0))
    for told in (run.wheel, run.yaw_rate):  # midway between asking and hearing
        assert told.t[20:22] == pytest.approx([0.0, 0.01], abs=1e-9)
    assert run.commands[:, 1] == pytest.approx(1.5)
    assert run.commands[159:161, 0] == pytest.approx([0.0, 0.1], abs=1e-6)
    assert run.duration == pytest.approx(3.8, abs=0.011)


# How much of the past a window is given: all that play may remember, and no more.
LEAST, MOST = 20, 400
PLAY = find_effect("steer_backlash")


def wheel_after(steering, play, wheel):
    """The wheel's angle after these servo angles, from a wheel somewhere in the gap."""
    for angle in steering:
        wheel, _ = PLAY.linkage(FLOAT, (play,), (wheel,), angle)
    return wheel


@settings(deadline=None)
@given(st.integers(0, 2**32), st.floats(1e-4, 0.1), st.floats(0.0, 0.15), st.floats(-1.0, 1.0))
def test_nothing_before_it_changes_where_the_wheel_is(seed, step, play, side):
    steering = np.cumsum(step * np.random.default_rng(seed).normal(size=600))
    steps = remembered(steering, 599, LEAST, MOST)
    assert LEAST <= steps <= MOST
    if steps < MOST:
        past = steering[599 - steps :]
        start = past[0] + 0.5 * play * side
        assert wheel_after(past, play, start) == wheel_after(steering, play, steering[0])


def test_a_stick_that_rests_is_given_the_whole_past():
    assert remembered(np.full(1000, 0.1), 999, LEAST, MOST) == MOST
    assert remembered(np.full(1000, 0.1), 999, LEAST, LEAST) == LEAST, "no play is asked for"
    assert remembered(np.full(1000, 0.1), 30, LEAST, MOST) == 80, "the drive's whole past"


# The log jitter of two timers is found in a drive and corrected; other logs stay as they are.
SECONDS, SPEED, LENGTH, LAG = 60.0, 1.5, 0.3, 0.06


def _drive(wait: float, drift: float):
    """Steering at 10 Hz, logged `wait` [s] late, then `drift` [s/s] more; times sent and logged."""
    rng = np.random.default_rng(3)
    left = 0.1 * np.arange(SECONDS / 0.1)
    steps = np.repeat(rng.uniform(-0.3, 0.3, 200), rng.integers(1, 9, 200))[: len(left)]
    t = np.arange(0.0, SECONDS, 0.002)
    held = steps[np.minimum((t / 0.1).astype(int), len(steps) - 1)]
    share = 1.0 - np.exp(-0.002 / LAG)
    angles = lfilter([share], [1.0, share - 1.0], held)
    yaw = np.cumsum(SPEED * np.tan(angles) / LENGTH) * 0.002
    place = np.cumsum(SPEED * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0) * 0.002
    poses = np.column_stack([place, yaw])[::5] + rng.normal(0.0, 5e-4, (len(t[::5]), 3))
    logged = left + np.mod(wait + drift * left, 0.1)
    return make_run("drive", Signal(logged, steps), None, Signal(t[::5], poses)), left, logged


def test_a_drifting_delay_is_found_and_corrected() -> None:
    run, left, logged = _drive(0.03, 0.002)
    jitter = find_log_jitter(run)
    assert jitter.period == pytest.approx(0.1, abs=2e-3)
    found = jitter.delay(logged[1:-1] - logged[0])
    off = (found - (logged - left)[1:-1] + 0.05) % 0.1 - 0.05
    off -= np.median(off)  # a common delay is a dead time: the fit finds it
    assert np.sqrt(np.mean(off**2)) < 0.012
    assert jitter.describe().startswith("drive: steering stored 0 to 100 ms late (")
    corrected = correct_log_jitter(run)
    assert (corrected.log_jitter, len(corrected.commands)) == (jitter, len(run.commands))


def test_other_delays_constant_steering_and_servo_signals_are_no_log_jitter() -> None:
    run, _, _ = _drive(0.04, 0.0)
    assert find_log_jitter(run) is None
    assert correct_log_jitter(run) is run
    t = np.arange(0.0, 10.0, 0.01)
    assert log_period(Signal(t, np.sin(t))) == 0.0
    assert log_period(Signal(t[::10], np.full(100, 0.3))) == 0.0
    run, _, _ = _drive(0.03, 0.002)
    pulsed = replace(run, servo_frame=0.02)
    assert correct_log_jitter(pulsed) is pulsed
