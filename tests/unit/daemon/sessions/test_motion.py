"""The motion of known drives, checks of units, signs and axes, and the lateral error shown."""

import numpy as np
import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions import motion
from steerd.daemon.sessions.info import seconds_since
from steerd.daemon.sessions.motion import find_implausible, make_track
from steerd.sysid.data.dataset import Signal

RADIUS, SPEED = 2.0, 1.5


def circle(count=1000, dt=0.01, *, noise=0.0, seed=1):
    t = np.arange(count) * dt
    yaw = SPEED / RADIUS * t
    x, y = RADIUS * np.sin(yaw), RADIUS * (1 - np.cos(yaw))
    rng = np.random.default_rng(seed)
    return t, x + noise * rng.normal(size=count), y + noise * rng.normal(size=count), yaw


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


@pytest.fixture
def state():
    """One row a second; the error is the row's number in centimetres, to either side."""
    seconds = np.arange(len(RUNNING))
    return {
        "stamp_ns": START_NS + seconds.astype(np.int64) * 10**9,
        "mode": np.where(RUNNING, int(SupervisorState.RUNNING), int(SupervisorState.ARMED)),
        "e1": 0.01 * seconds * np.where(seconds % 2, -1.0, 1.0),
    }


def test_each_start_settles_anew(state):
    settled = motion.find_settled(state, seconds_since(START_NS, state["stamp_ns"]))
    assert np.flatnonzero(settled).tolist() == [4, 5, 11]
    assert motion.SETTLE == 3.0


def test_errors_are_sizes_and_unknown_ones_are_left_out(state):
    state["e1"][5] = np.nan
    errors = motion.settled_errors(state, seconds_since(START_NS, state["stamp_ns"]))
    assert errors == pytest.approx([0.04, 0.11])
    assert motion.rms(errors) == pytest.approx(np.sqrt((0.04**2 + 0.11**2) / 2))
