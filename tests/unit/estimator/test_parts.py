"""The filter's parts: actuators, history, gates, the first belief, settings."""

import math
from dataclasses import asdict, fields

import numpy as np
import pytest
from scipy.special import chdtri

from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.rollout import simulate as simulate_car
from steerd.car_model.rollout import start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command
from steerd.estimator.config import FilterConfig, load_filter_config
from steerd.estimator.history import NO_HISTORY, History, add_command, command_at, drop_older
from steerd.estimator.initial import initial_belief
from steerd.estimator.reference import Reference
from steerd.estimator.sensors import chi_square_gate, make_pose

MS = 1_000_000
CAR = DEFAULT_CAR._replace(steer_delay=0.012, drive_delay=0.004)
drive = Reference(CAR, SINGLE_TRACK, FilterConfig(), {}).drive


def random_history(seed: int, scale: float = 1.0):
    """Commands every 5 ms about straight on at 1.5 m/s; at full scale they reach every limit."""
    rng = np.random.default_rng(seed)
    draws = scale * rng.uniform(-1.0, 1.0, (40, 2))
    commands = [Command(0.4 * float(a), 1.5 + 1.5 * float(v)) for a, v in draws]
    return History(tuple(range(0, 200 * MS, 5 * MS)), tuple(commands)), commands


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("scale", "tolerance"), [(0.1, 1e-12), (1.0, 0.02)])
def test_actuators_follow_the_car_model_under_delayed_commands(seed, scale, tolerance):
    """To the last digit within the slew limits; a limit left midway is only met to a step."""
    history, commands = random_history(seed, scale=scale)
    grid = [command for command in commands for _ in range(5)]
    first = ORIGIN._replace(speed=1.5, steer=0.02)
    run = simulate_car(FLOAT, Model(CAR), start(Model(CAR), first, 0.0), grid, 0.001)
    now, then = run[30].state, run[190].state
    out = drive(history, now.steer, now.speed, 30 * MS, 190 * MS)
    assert out.steer == pytest.approx(then.steer, abs=tolerance)
    assert now.speed + 0.16 * out.accel == pytest.approx(then.speed, abs=tolerance)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("span_ms", [2, 5, 17])
def test_derivatives_are_exact(seed, span_ms):
    history, span = random_history(seed)[0], (61 * MS, (61 + span_ms) * MS)
    at, eps = np.random.default_rng(seed).uniform((-0.2, 1.0), (0.2, 2.0)), 1e-7
    out, right = (drive(history, *x.tolist(), *span) for x in (at, at + eps))
    assert (right.steer - out.steer) / eps == pytest.approx(out.steer_by_steer, abs=1e-6)
    assert (right.wheel - out.wheel) / eps == pytest.approx(out.wheel_by_steer, abs=1e-6)
    assert (right.accel - out.accel) / eps == pytest.approx(out.accel_by_speed, abs=1e-6)


def test_without_a_command_steering_holds_and_the_car_rolls():
    out = drive(NO_HISTORY, 0.2, 1.0, 0, 10 * MS)
    assert (out.steer, out.wheel, out.accel) == (0.2, 0.2, 0.0)
    released = add_command(add_command(NO_HISTORY, 0, Command(0.3, 3.0)), 5 * MS, None)
    out = drive(released, 0.2, 1.0, 30 * MS, 40 * MS)
    assert (out.steer, out.accel, out.steered) == (0.2, 0.0, False)


def test_history_keeps_order_and_the_command_in_force():
    history = NO_HISTORY
    for t in (20, 0, 10):
        history = add_command(history, t, Command(float(t), 0.0))
    assert history.times == (0, 10, 20)
    assert command_at(history, -1) is None
    assert command_at(history, 15) == Command(10.0, 0.0)
    assert add_command(history, 10, None).commands[1] is None
    assert drop_older(history, 15).times == (10, 20)
    assert drop_older(history, -5).times == history.times
    for bad in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not finite"):
            add_command(NO_HISTORY, 0, Command(0.0, bad))


# The chi-square gate against SciPy's quantile.
@pytest.mark.parametrize("degrees", [1, 2, 3, 7])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.999, 0.999999])
def test_gate_is_scipys_quantile(degrees, probability):
    expected = chdtri(degrees, 1.0 - probability)
    assert chi_square_gate(degrees, probability) == pytest.approx(expected, rel=1e-9)


# The first belief, from poses alone.
CONFIG = FilterConfig()


def poses_on_a_curve(seed, speed, yaw, yaw_rate, slip):
    """Poses at 100 Hz that end at the origin with the given motion."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(10):
        t, n = (i - 9) * 0.01, rng.standard_normal(3)
        psi, course = yaw + yaw_rate * t, yaw + slip + 0.5 * yaw_rate * t
        x = speed * t * math.cos(course) + CONFIG.pose_position_sd * n[0]
        y = speed * t * math.sin(course) + CONFIG.pose_position_sd * n[1]
        wrapped = math.remainder(psi + CONFIG.pose_yaw_sd * n[2], math.tau)
        out.append(make_pose(10**12 + i * 10 * MS, x, y, wrapped))
    return out


@pytest.mark.parametrize(("speed", "yaw", "yaw_rate", "slip"), [
    (0.0, 0.4, 0.0, 0.0), (2.0, 3.1, 1.0, 0.03), (-1.5, -2.0, 0.4, 0.0), (0.3, 1.0, -0.5, 0.0),
])  # fmt: skip
def test_first_belief_covers_the_truth(speed, yaw, yaw_rate, slip):
    truth = np.array([0.0, 0.0, yaw, speed, yaw_rate, slip])
    errors = []
    for seed in range(50):
        belief = initial_belief(CONFIG, poses_on_a_curve(seed, speed, yaw, yaw_rate, slip), 0.0)
        error = belief.mean[:6] - truth
        error[2] = math.remainder(error[2], math.tau)
        errors.append(error / np.sqrt(np.diag(belief.covariance)[:6]))
    assert np.abs(errors).max() < 4.0
    assert np.abs(np.mean(errors, axis=0)).max() < 1.0


@pytest.mark.parametrize("index", range(10))
@pytest.mark.parametrize("shift", [(0.5, 0.0, 0.0), (0.0, 0.0, math.pi)])
def test_one_wrong_pose_stops_the_start(index, shift):
    poses = poses_on_a_curve(1, 1.0, 0.0, 0.0, 0.0)
    x, y, yaw = (a + b for a, b in zip(poses[index].values, shift, strict=True))
    poses[index] = make_pose(poses[index].t_ns, x, y, yaw)
    assert initial_belief(CONFIG, poses, None) is None


def test_poses_far_apart_start_no_filter_and_those_of_a_carried_car_one_without_slip():
    poses = [make_pose(i * 100 * MS, 0.0, 0.0, 0.0) for i in range(10)]
    assert initial_belief(CONFIG, poses, None) is None
    assert initial_belief(CONFIG, [poses[0]] * 10, None) is None
    poses = [make_pose(i * 10 * MS, 0.0, 0.01 * i, 0.0) for i in range(10)]
    assert initial_belief(CONFIG, poses, None).mean[5] == 0.0


# Settings.
def test_defaults_pass_their_own_validation():
    assert load_filter_config(asdict(CONFIG)) == load_filter_config({}) == CONFIG


@pytest.mark.parametrize(("mapping", "words"), [
    ({"pose_sd": 0.1}, "unknown key 'pose_sd' (known: pose_position_sd"),
    ({"gyro_sd": "much"}, "gyro_sd must be a number, not 'much'"),
    ({"gyro_sd": True}, "gyro_sd must be a number, not True"),
    ({"gyro_sd": -1.0}, "gyro_sd = -1.0 is outside 1e-06 .. 10"),
    ({"wheel_speed_sd": 0.0}, "wheel_speed_sd = 0.0 is outside"),
    ({"history_s": 0.3}, "history_s = 0.3 is outside 0.5 .. 2"),
    ({"initial_poses": 7.5}, "initial_poses must be a whole number"),
])  # fmt: skip
def test_each_problem_is_named(mapping, words):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        load_filter_config(mapping)
    assert words in str(caught.value)


@pytest.mark.parametrize("name", [field.name for field in fields(FilterConfig)])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_no_field_takes_nonsense(name, bad):
    with pytest.raises(ValueError, match=name):
        load_filter_config({name: bad})
