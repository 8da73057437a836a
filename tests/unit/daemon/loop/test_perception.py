"""Perception: accepted poses are fused, ages and speeds are unknown until measured."""

from dataclasses import replace
from math import inf, isnan, nan

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.loop import perception as ps
from steerd.daemon.settings.config import make_settings
from steerd.estimator.config import FilterConfig
from steerd.steer_bus.quick_values import changed
from steerd.vesc_link.scaling import F1TENTH
from tests.unit.daemon.loop.watching import seen as seen_pose

MS, NS = 1_000_000, 1_000_000_000


def make_perception(**noise):
    settings = make_settings(load_car(default_car_path()))
    return ps.Perception(DEFAULT_CAR, replace(settings, filter=FilterConfig(**noise)))


def pose(t_ns, x, **more):
    return seen_pose(t_ns, (x, 0.0, 0.1), **more)


def telemetry(t_ns, erpm):
    return changed(ps.NO_TELEMETRY, t_sent_ns=t_ns - MS, t_received_ns=t_ns, erpm=erpm)


def drive(speed=1.0):
    """What has seen the poses and the telemetry of a second straight on, and its end."""
    seen = make_perception()
    for k in range(1, 101):
        t_ns = k * 10 * MS
        seen.on_pose(pose(t_ns, speed * t_ns / NS))
        seen.on_telemetry(telemetry(t_ns, speed * F1TENTH.erpm_gain))
        seen.estimate(t_ns)
    return seen, t_ns


def test_nothing_is_known_before_the_first_measurement():
    seen = make_perception()
    assert seen.estimate(NS) is None
    assert (seen.mocap_age(NS), seen.telemetry_age(NS)) == (inf, inf)
    unknown = (seen.wheel_speed, seen.mocap_speed, *ps.NO_STATE)
    assert all(isnan(value) for value in unknown)


def test_a_straight_drive_is_estimated():
    seen, end = drive()
    estimate = seen.estimate(end)
    assert estimate.state.speed == pytest.approx(1.0, abs=0.05)
    assert estimate.state.x == pytest.approx(1.0, abs=0.05)
    assert (seen.wheel_speed, seen.mocap_speed) == pytest.approx((1.0, 1.0))
    assert seen.mocap_age(end + 30 * MS) == pytest.approx(0.03)
    assert seen.telemetry_age(end + 20 * MS) == pytest.approx(0.02)


@pytest.mark.parametrize(("sd", "span"), [(0.001, 0.1), (0.008, 0.16), (0.05, 0.2)])
def test_mocap_speed_is_taken_over_longer_where_poses_are_noisier(sd, span):
    seen = make_perception(pose_position_sd=sd)
    for k in range(60):
        seen.on_pose(pose(k * 10 * MS, 0.01 * max(0, k - 55)))
        seen.estimate(k * 10 * MS)
    assert seen.mocap_speed == pytest.approx(0.04 / span)


@pytest.mark.parametrize("bad", [{"rejected": "jump"}, {"tracking_valid": False}])
def test_a_rejected_pose_does_not_renew_the_age(bad):
    seen, end = drive()
    seen.on_pose(pose(end + 10 * MS, 1.01, **bad))
    assert seen.accepted_ns == end


def test_a_jump_while_driving_is_not_fused():
    seen, end = drive()
    seen.may_rebase = False
    seen.on_pose(pose(end + 10 * MS, 5.0))
    assert seen.watch.jumps == 1
    assert seen.estimate(end + 10 * MS).state.x == pytest.approx(1.0, abs=0.05)


def test_a_car_that_was_carried_starts_anew_where_it_stands():
    seen, end = drive(speed=0.0)
    for k in range(1, 51):
        seen.on_pose(pose(end + 10 * k * MS, 5.0))
    assert seen.estimate(end + 500 * MS).state.x == pytest.approx(5.0, abs=0.05)


def test_a_speed_that_is_old_is_unknown_and_until_then_the_filters_is_the_best():
    seen, end = drive()
    late = end + round(ps.BLIND_S * NS)
    assert seen.recent_wheel_speed(late) == pytest.approx(1.0)
    assert isnan(seen.recent_wheel_speed(late + MS))
    assert ps.best_speed(seen.estimate(end), nan) == pytest.approx(1.0, abs=0.05)
    assert ps.best_speed(None, 0.7) == 0.7
    assert isnan(ps.best_speed(seen.estimate(end + 2 * NS), 0.7))
