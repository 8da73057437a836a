"""Runs of the plain car: rest, crawl, straight, circle, order of the integrator, delays."""

import math
from itertools import pairwise

import pytest

from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model, believed_car
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR, wheelbase
from steerd.car_model.rollout import euler, rk4, simulate, start, stiffness_rate
from steerd.car_model.state import ORIGIN, Command


def run(car, first, command, seconds, h=0.005, integrate=rk4):
    model, commands = Model(car), [command] * round(seconds / h)
    moments = simulate(FLOAT, model, start(model, first, 0.0), commands, h, integrate)
    return [m.state for m in moments]


def test_rest_stays_at_rest_and_reverse_is_kinematic_and_stable() -> None:
    assert set(run(DEFAULT_CAR, ORIGIN, Command(0.0, 0.0), 1.0)) == {ORIGIN}
    last = run(DEFAULT_CAR, ORIGIN, Command(0.3, -1.0), 3.0)[-1]
    assert last.speed == pytest.approx(-1.0, rel=1e-6)
    assert last.yaw_rate < 0.0
    assert abs(last.slip_angle) < 0.2


def test_speed_and_steering_follow_their_lags_and_then_their_limits():
    car = DEFAULT_CAR._replace(accel_max=20.0)
    reached = run(car, ORIGIN, Command(0.0, 1.0), car.speed_lag)[-1].speed
    assert reached == pytest.approx(1.0 - math.exp(-1.0), rel=1e-12)
    limited = run(DEFAULT_CAR, ORIGIN, Command(0.0, 4.0), 0.2)[-1].speed
    assert limited == pytest.approx(0.2 * DEFAULT_CAR.accel_max, rel=1e-12)
    states = run(DEFAULT_CAR, ORIGIN, Command(1.0, 0.0), 2.0)
    speeds = [(b.steer - a.steer) / 0.005 for a, b in pairwise(states)]
    assert max(speeds) == pytest.approx(DEFAULT_CAR.steer_rate, rel=1e-9)
    assert states[-1].steer == pytest.approx(DEFAULT_CAR.steer_max, rel=1e-9)


def test_halving_the_step_divides_the_error_by_sixteen() -> None:
    # Wheels that slew all the time: within a step they are taken to move evenly, and so they do.
    drive = (DEFAULT_CAR._replace(steer_lag=0.0, steer_rate=0.1), ORIGIN._replace(speed=2.0),
             Command(0.3, 2.0), 0.32)  # fmt: skip
    *ends, truth = (run(*drive, h)[-1] for h in (0.02, 0.01, 0.005, 0.00025))
    for coarse, fine in pairwise(math.dist(end[:2], truth[:2]) for end in ends):
        assert 10.0 < coarse / fine < 40.0


def test_the_papers_euler_agrees_to_its_own_error() -> None:
    """`docs/reference/identification.md#i2.1`: 2 mm after 8 s on a circle at 1 m/s."""
    drive = PAPER_CAR, ORIGIN._replace(speed=1.0), Command(0.34, 1.0), 8.0, 0.002
    exact, papers = (run(*drive, integrate) for integrate in (rk4, euler))
    worst = max(math.dist(a[:2], b[:2]) for a, b in zip(exact, papers, strict=True))
    assert 1e-4 < worst < 5e-3


def test_a_slow_car_is_stable_at_the_rate_that_is_its_bound() -> None:
    fine = 2.0 / stiffness_rate(DEFAULT_CAR, 0.5)
    assert fine < 0.02 < 2.0 / stiffness_rate(DEFAULT_CAR, 5.0)
    last = run(DEFAULT_CAR, ORIGIN._replace(speed=0.5), Command(0.3, 0.5), 2.0, fine)[-1]
    assert abs(last.yaw_rate) < 2.0


def test_a_delayed_command_moves_the_wheels_late() -> None:
    model = Model(DEFAULT_CAR._replace(steer_delay=0.1))
    commands = [Command(0.0, 0.0)] + [Command(0.2, 0.0)] * 60
    moments = simulate(FLOAT, model, start(model, ORIGIN, 0.0), commands, 0.005)
    assert next(k for k, m in enumerate(moments) if m.state.steer > 0.0) == 1 + 20 + 1


# Effects that are changes of parameters reach designs; without effects nothing changes.
def believed(text):
    effects, values = zip(*parse_effects(text), strict=True)
    return believed_car(Model(DEFAULT_CAR, effects, values))


def test_dead_times_add_up_and_other_parameters_become_what_effects_of_the_whole_car_make_them():
    car = believed("steer_delay=0.05,drive_delay=0.02,mocap_latency=0.01")
    assert car.steer_delay == pytest.approx(DEFAULT_CAR.steer_delay + 0.05)
    assert car.drive_delay == pytest.approx(DEFAULT_CAR.drive_delay + 0.02)
    assert car.pose_delay == pytest.approx(DEFAULT_CAR.pose_delay + 0.01)
    car = believed("steer_lag=0.04,steer_gain=0.9,cog_offset=0.02")
    assert car.steer_lag == pytest.approx(DEFAULT_CAR.steer_lag + 0.04)
    assert car.steer_gain == pytest.approx(0.9 * DEFAULT_CAR.steer_gain)
    assert car.lr == pytest.approx(DEFAULT_CAR.lr + 0.02)
    assert wheelbase(car) == pytest.approx(wheelbase(DEFAULT_CAR))
    assert believed("grip_patch:x=0,y=0,radius=3,drop=0.4").mu == pytest.approx(DEFAULT_CAR.mu)
