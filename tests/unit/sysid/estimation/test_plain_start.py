"""The search begins at a car of the drives' own size, whatever that is."""

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, wheelbase
from steerd.sysid.data.dataset import Signal, make_run
from steerd.sysid.estimation.plain_start import LOCK, WIDEST, possible_starts, rolling_length
from steerd.sysid.inference.teaching import NOTHING, Stated

MODEL = Model(DEFAULT_CAR)
LENGTHS = (0.1, 0.15, 0.33, 0.8, 3.0)


def drive(length, seed, *, unit=1.0, delay=0.1, rate=20.0, blur=0.001):
    """A rolling car of some wheelbase, its commands in some unit of their own."""
    rng = np.random.default_rng([3, seed])
    t = np.arange(0.0, 30.0, 0.005)
    turns = np.cumsum(rng.normal(size=len(t))) * 0.02
    steer = 0.35 * np.sin(0.9 * t + turns) + 0.05 * np.sin(0.13 * t)
    speed = min(1.0, np.sqrt(4.0 * length)) * (1.0 + 0.3 * np.sin(0.4 * t))
    wheels = np.interp(t - delay, t, steer)
    yaw = np.cumsum(speed * np.tan(wheels) / length) * 0.005
    x, y = (np.cumsum(speed * part) * 0.005 for part in (np.cos(yaw), np.sin(yaw)))
    at = np.arange(0.0, 29.9, 1.0 / rate)
    pose = np.column_stack([np.interp(at, t, each) for each in (x, y, yaw)])
    pose[:, :2] += blur * rng.normal(size=(len(at), 2))
    pose[:, 2] += 2.0 * blur * rng.normal(size=len(at))
    return make_run("drive", Signal(t, steer / unit), None, Signal(at, pose))


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("seed", [1, 2])
def test_the_wheelbase_follows_from_the_curvature(length, seed):
    start, *given = possible_starts(MODEL, [drive(length, seed)], NOTHING)
    assert wheelbase(start.car) == pytest.approx(length, rel=0.1)
    assert start.car.lf / start.car.lr == pytest.approx(DEFAULT_CAR.lf / DEFAULT_CAR.lr)
    size = wheelbase(start.car) / wheelbase(DEFAULT_CAR)
    assert start.car.inertia_z == pytest.approx(DEFAULT_CAR.inertia_z * size**2)
    assert given in ([], [MODEL])


@pytest.mark.parametrize("length", LENGTHS)
def test_a_stated_wheelbase_stays_and_the_curvature_gives_the_steerings_unit(length):
    scale = length / wheelbase(DEFAULT_CAR)
    car = DEFAULT_CAR._replace(lf=DEFAULT_CAR.lf * scale, lr=DEFAULT_CAR.lr * scale)
    start = possible_starts(Model(car), [drive(length, 3, unit=0.5)], Stated(wheelbase=True))[0]
    assert (start.car.lf, start.car.lr) == (car.lf, car.lr)
    assert start.car.steer_gain == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("length", LENGTHS)
def test_commands_that_no_wheel_follows_have_a_unit_of_their_own(length):
    run = drive(length, 4, unit=0.4)
    widest = float(np.abs(run.commands[:, 0]).max())
    assert widest > WIDEST
    start = possible_starts(MODEL, [run], NOTHING)[0]
    assert start.car.steer_gain * widest == pytest.approx(LOCK)
    assert wheelbase(start.car) == pytest.approx(start.car.steer_gain / 0.4 * length, rel=0.1)


def test_what_is_held_stays():
    run = drive(0.33, 5, unit=0.5)
    held = Stated(wheelbase=True, held=("steer_gain",))
    assert possible_starts(MODEL, [run], held) == (MODEL,)
    start = possible_starts(MODEL, [run], Stated(held=("steer_gain",)))[0]
    assert start.car.steer_gain == MODEL.car.steer_gain


def test_poses_of_a_centimetre_and_steady_circles_show_the_curvature():
    noisy = drive(0.33, 6, rate=50.0, blur=0.01)
    assert rolling_length([noisy], 1.0) == pytest.approx(0.33, rel=0.15)
    steady = drive(0.33, 7)
    for sign in (1.0, -1.0):
        t, yaw = steady.pose.t, sign * steady.pose.t * np.tan(0.2) / 0.33
        radius = sign * 0.33 / np.tan(0.2)
        pose = np.column_stack([radius * np.sin(yaw), -radius * np.cos(yaw), yaw])
        run = make_run("circle", Signal(t, np.full(len(t), 0.2 * sign)), None, Signal(t, pose))
        assert rolling_length([run], 1.0) == pytest.approx(0.33, rel=0.05)
