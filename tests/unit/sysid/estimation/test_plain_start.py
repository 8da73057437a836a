"""The search begins at a car of the drives' own size, whatever that is."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR, wheelbase
from steerd.sysid.data.dataset import Signal, make_run
from steerd.sysid.estimation import preparation as prep
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.validation import Trace, by_lateral_acceleration
from steerd.sysid.inference.car_fit import NOTHING, Stated
from steerd.sysid.inference.identifiability import Estimate
from steerd.sysid.inference.plain_car import DEFAULT_FREE

MODEL, TYRES = Model(DEFAULT_CAR), EFFECTS["tyre_saturation"]
LENGTHS = (0.1, 0.15, 0.33, 0.8, 3.0)


def drive(length, seed, *, unit=1.0, rate=20.0, blur=0.001):
    """A rolling car of some wheelbase, its commands in some unit of their own."""
    rng = np.random.default_rng([3, seed])
    t = np.arange(0.0, 30.0, 0.005)
    turns = np.cumsum(rng.normal(size=len(t))) * 0.02
    steer = 0.35 * np.sin(0.9 * t + turns) + 0.05 * np.sin(0.13 * t)
    speed = min(1.0, np.sqrt(4.0 * length)) * (1.0 + 0.3 * np.sin(0.4 * t))
    wheels = np.interp(t - 0.1, t, steer)
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
    start, *given = prep.possible_starts(MODEL, [drive(length, seed)], NOTHING)
    assert wheelbase(start.car) == pytest.approx(length, rel=0.1)
    assert start.car.lf / start.car.lr == pytest.approx(DEFAULT_CAR.lf / DEFAULT_CAR.lr)
    size = wheelbase(start.car) / wheelbase(DEFAULT_CAR)
    assert start.car.inertia_z == pytest.approx(DEFAULT_CAR.inertia_z * size**2)
    assert given in ([], [MODEL])


@pytest.mark.parametrize("length", LENGTHS)
def test_a_stated_wheelbase_stays_and_the_curvature_gives_the_steerings_unit(length):
    scale = length / wheelbase(DEFAULT_CAR)
    car = DEFAULT_CAR._replace(lf=DEFAULT_CAR.lf * scale, lr=DEFAULT_CAR.lr * scale)
    drives, known = [drive(length, 3, unit=0.5)], Stated(wheelbase=True)
    start = prep.possible_starts(Model(car), drives, known)[0]
    assert (start.car.lf, start.car.lr) == (car.lf, car.lr)
    assert start.car.steer_gain == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("length", LENGTHS)
def test_commands_that_no_wheel_follows_have_a_unit_of_their_own(length):
    run = drive(length, 4, unit=0.4)
    widest = float(np.abs(run.commands[:, 0]).max())
    assert widest > prep.WIDEST
    start = prep.possible_starts(MODEL, [run], NOTHING)[0]
    assert start.car.steer_gain * widest == pytest.approx(prep.LOCK)
    assert wheelbase(start.car) == pytest.approx(start.car.steer_gain / 0.4 * length, rel=0.1)


def test_what_is_held_stays():
    run, held = drive(0.33, 5, unit=0.5), Stated(held=("steer_gain",))
    assert prep.possible_starts(MODEL, [run], held._replace(wheelbase=True)) == (MODEL,)
    start = prep.possible_starts(MODEL, [run], held)[0]
    assert start.car.steer_gain == MODEL.car.steer_gain


def test_tyres_level_off_in_further_starts_where_a_drive_uses_up_the_grip():
    hard, grip = [drive(0.33, 1)], Model(DEFAULT_CAR._replace(mu=0.2))
    found = prep.sliding_starts([grip])
    assert [m.values for m in found] == [(), ((1.0, 0.5),), ((3.0, 0.5),)]
    assert prep.sliding_starts(found[1:2]) == found  # whatever they do already
    asked = [([grip], NOTHING), ([MODEL], NOTHING), ([grip], Stated(held=(TYRES.name,)))]
    assert [prep.slides(m, hard, stated) for m, stated in asked] == [True, False, False]


def test_poses_of_a_centimetre_and_steady_circles_show_the_curvature():
    noisy = drive(0.33, 6, rate=50.0, blur=0.01)
    assert prep.rolling_length([noisy], 1.0) == pytest.approx(0.33, rel=0.15)
    steady = drive(0.33, 7)
    for sign in (1.0, -1.0):
        t, yaw = steady.pose.t, sign * steady.pose.t * np.tan(0.2) / 0.33
        radius = sign * 0.33 / np.tan(0.2)
        pose = np.column_stack([radius * np.sin(yaw), -radius * np.cos(yaw), yaw])
        run = make_run("circle", Signal(t, np.full(len(t), 0.2 * sign)), None, Signal(t, pose))
        assert prep.rolling_length([run], 1.0) == pytest.approx(0.33, rel=0.05)


# Drives at one speed: other starts, and what is left open where ends differ.
@pytest.fixture(scope="module")
def slow(make_drive, truth):
    return make_drive(truth, 24.0, 4, speed=1.2)


def test_one_speed_is_told_from_several_and_starts_keep_axles_and_what_is_fixed(
    slow, make_drive, truth
):
    assert prep.has_one_speed([slow])
    assert not prep.has_one_speed([make_drive(truth, 24.0, 4)])
    start, *others = prep.candidate_starts(truth, DEFAULT_FREE)
    assert start == truth
    assert len({other.car.lr for other in others}) == 2
    assert len({other.car.steer_delay for other in others}) == 2
    for other in others:
        assert wheelbase(other.car) == pytest.approx(wheelbase(truth.car))
    assert prep.candidate_starts(truth, ("lf", "c_sf", "steer_lag")) == [truth]


def test_what_two_ends_place_differently_is_left_open():
    first = Estimate(0.96, 0.01, True)
    found = {"steer_gain": first, "steer_bias": Estimate(0.01, 1e-4, True)}

    def other(by):
        return {**found, "steer_gain": replace(first, value=first.value + by * first.sd)}

    assert prep.mark_ambiguous(found, [other(0.1)]) == found
    left = prep.mark_ambiguous(found, [other(0.1), other(3.0)])
    assert not left["steer_gain"].identifiable
    assert left["steer_gain"].sd == pytest.approx(3.0 * first.sd)
    assert "as well" in left["steer_gain"].manoeuvre
    assert left["steer_bias"] == found["steer_bias"]


@pytest.mark.slow
def test_one_speed_tells_no_more_than_it_can(slow, truth):
    outcome = learn(Task((slow,), MODEL, prep.FitOptions(wheelbase=0.332)), lambda: 0.0)
    for name, row in outcome.free_rows.items():
        if row.identifiable:
            assert abs(row.value - getattr(truth.car, name)) < 4.0 * row.sd, name


# Start values that do not stand in the way: inertia, loads and end stops of another car.
def _run(steer=0.3, speed=True, servo_frame=0.0, shape=np.sin):
    t = np.arange(0.0, 8.0, 0.01)
    poses = np.column_stack([t, np.sin(t), 0.2 * np.sin(t)])
    asked = Signal(t, np.ones(len(t))) if speed else None
    run = make_run("r", Signal(t, steer * shape(t)), asked, Signal(t, poses))
    return replace(run, servo_frame=servo_frame)


def test_inertia_follows_mass_and_length_squared_and_loads_no_measured_speed():
    halved = {name: getattr(DEFAULT_CAR, name) / 2 for name in ("lf", "lr", "mass")}
    half = Model(DEFAULT_CAR._replace(**halved))
    assert prep.scale_inertia(half, MODEL).car.inertia_z == pytest.approx(DEFAULT_CAR.inertia_z / 8)
    assert prep.scale_inertia(MODEL, MODEL) == MODEL
    assert prep.level_loads(MODEL, [_run(speed=False)]).car.cog_height == 0.0
    assert prep.level_loads(MODEL, [_run()]) == MODEL


def test_end_stops_of_another_car_do_not_clip_a_log():
    run = _run(steer=0.3)
    wide = prep.widen_end_stops(MODEL, [run], ()).car
    assert wide.steer_max == -wide.steer_min == pytest.approx(0.45, abs=1e-3)
    assert prep.widen_end_stops(MODEL, [_run(steer=0.1)], ()) == MODEL
    assert prep.widen_end_stops(MODEL, [run], ("steer_max",)) == MODEL
    assert prep.widen_end_stops(MODEL, [_run(servo_frame=0.02)], ()) == MODEL
    known = prep.restore_end_stops(wide._replace(steer_gain=1.4), MODEL.car, [run])
    assert known.steer_max == pytest.approx(1.4 * prep.largest_steering([run]), rel=1e-3)
    assert prep.restore_end_stops(wide, MODEL.car, [run]).steer_max == MODEL.car.steer_max


def test_errors_are_told_by_lateral_acceleration():
    ahead = np.arange(-0.4, 1.5, 0.05)

    def trace(rate, off):
        yaw = rate * ahead
        measured = np.column_stack([np.sin(yaw) / rate, (1 - np.cos(yaw)) / rate, yaw])
        return Trace(ahead, measured, measured + np.array([off, 0.0, 0.0]))

    slow, fast = by_lateral_acceleration([trace(1.0, 0.01), trace(3.0, 0.2)], 1.0)
    assert (slow[:3], slow.median) == ((0.0, 2.0, 1), pytest.approx(0.01))
    assert (fast.lateral_accel_low, fast.rms) == (2.0, pytest.approx(0.2))
    assert by_lateral_acceleration([], 1.0) == ()


def test_only_steps_that_the_file_s_servo_cannot_follow_outpace_it():
    steps = _run(0.2, shape=lambda t: np.sign(np.sin(t)))
    ramps = _run(0.3, shape=lambda t: np.clip(10.0 * (np.abs(t % 4.0 - 2.0) - 1.0), -1.0, 1.0))
    assert prep.exceeds_slew_rate(MODEL, [steps])
    assert not prep.exceeds_slew_rate(MODEL, [ramps])
    fast = MODEL._replace(car=DEFAULT_CAR._replace(steer_rate=12.0))
    assert not prep.exceeds_slew_rate(fast, [steps])
