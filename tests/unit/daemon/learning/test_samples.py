"""Messages of a drive as samples of the learner."""

from math import nan

import pytest

from steerd.daemon.learning.samples import Wiring, make_sample
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics

EPOCH = 1_700_000_000_000_000_000
WIRING = Wiring(EPOCH, 4000.0, 100.0)


def pose(reject=""):
    header = m.make_header(EPOCH + 2_000_000_000, m.WORLD)
    raw = (0.0,) * 8
    return m.MocapPose(
        header, 2_000_000_000, 2_004_000_000, 0, 1, 0, 1, *raw, 1.0, 2.0, 0.3, 0.1, 0.0, reject
    )


def actuation(mode):
    return m.Actuation(m.make_header(EPOCH + 3_000_000_000, m.BODY), 7, mode, 0.1, 1.5, nan, b"")


def telemetry(erpm):
    header = m.make_header(EPOCH, m.BODY)
    return m.VescTelemetry(
        header, 1_000_000_000, 1_002_000_000, 5, erpm, 0, 0, 0, 0, *(0.0,) * 10
    )  # fmt: skip


def test_a_pose_counts_when_it_was_taken():
    assert make_sample(WIRING, topics.MOCAP, pose()) == PoseSeen(2.0, 1.0, 2.0, 0.3)


def test_a_pose_that_was_refused_says_nothing():
    assert make_sample(WIRING, topics.MOCAP, pose("jump")) is None


def test_a_command_counts_when_it_was_sent():
    order = make_sample(WIRING, topics.ACTUATION, actuation(m.ActuationMode.SPEED))
    assert order == Ordered(3.0, 0.1, 1.5)


@pytest.mark.parametrize("mode", [mode for mode in m.ActuationMode if mode != 1])
def test_any_other_order_is_a_pause(mode):
    assert make_sample(WIRING, topics.ACTUATION, actuation(mode)) == Paused(3.0)


def test_wheel_speed_is_in_the_sessions_own_scaling():
    rolled = make_sample(WIRING, topics.VESC, telemetry(6100))
    assert rolled == Rolled(pytest.approx(1.001), 1.5)


def test_an_encoder_counts_like_telemetry():
    wheel = m.WheelSpeed(m.make_header(EPOCH, m.BODY), 4_000_000_000, 1.25)
    assert make_sample(WIRING, topics.WHEEL, wheel) == Rolled(4.0, 1.25)
