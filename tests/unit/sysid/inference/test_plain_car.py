"""The plain car finds injected truth, says how sure it is, and says what it cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from steerd.car_model.chassis import derivative
from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.planar import make_planar
from steerd.car_model.state import State
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Signal, make_run
from steerd.sysid.data.segments import make_blocks
from steerd.sysid.estimation.outcome import fit_of_plain
from steerd.sysid.inference import plain_car
from steerd.sysid.inference.augmented_car import prescribe_speed
from steerd.sysid.inference.chart import SPREAD
from steerd.sysid.inference.predictor import stable_substeps
from steerd.sysid.paper import NAMES as TYRES
from steerd.sysid.paper import PAPER_CAR_DIRECT as STILL

SLID = (0.18917528114233922, 0.29462271010112046, 5.025340279936621, 2.177483451231206)
"""Lengths and stiffnesses of a start in the long valley of long, sliding cars that steer more."""


def fit(runs, model, free=plain_car.DEFAULT_FREE, *, wheelbase=None, start=None, doubts=()):
    """As `learn` does where the plain car explains the drives."""
    blocks = make_blocks(runs)
    asked = plain_car.Asked(model, plain_car.free_of(blocks, free), wheelbase)
    rough = plain_car.search_plain(blocks, asked._replace(model=start or model))
    found = plain_car.search_plain(blocks, asked, rough)
    return fit_of_plain(found, blocks, plain_car.Asked(model, free, wheelbase), doubts)


def _pulls(found, truth):
    values = truth.car._asdict()
    return np.array([(e.value - values[name]) / e.sd for name, e in found.estimates.items()])


PLAIN = Model(DEFAULT_CAR)


minute = pytest.fixture(lambda make_drive, truth: make_drive(truth, 60.0, 1), scope="module")


def test_a_minute_of_driving_tells_eleven_parameters(minute, truth):
    found = fit([minute], PLAIN)
    assert found.converged
    assert set(found.estimates) == set(plain_car.DEFAULT_FREE)
    assert np.abs(_pulls(found, truth)).max() < 4.0
    for name in TYRES:
        value, wanted = found.estimates[name].value, truth.car._asdict()[name]
        assert value == pytest.approx(wanted, rel=1e-2)
    assert all(e.identifiable for e in found.estimates.values())
    assert all(0.9 < ratio < 1.1 for ratio in found.misfit.values())
    assert found.residuals.signal[:2] == pytest.approx([1e-3, 2e-3], rel=0.05)
    assert np.allclose(np.diag(found.correlation), 1.0)


@pytest.mark.slow
def test_errors_have_the_size_that_is_claimed(make_drive, truth):
    pulls = [_pulls(fit([make_drive(truth, 24.0, s)], PLAIN), truth) for s in range(6)]
    rms = float(np.sqrt(np.mean(np.square(pulls))))
    assert 0.6 < rms < 1.3


@pytest.mark.parametrize(("far", "seed"), [
    ((0.325, 0.214, 2.939, 2.824), 4), ((0.324, 0.324, 7.0, 7.0), 80), (SLID, 6072),
])  # fmt: skip
def test_a_start_in_the_long_valley_of_similar_cars_arrives(make_drive, truth, far, seed):
    start = Model(DEFAULT_CAR._replace(**dict(zip(TYRES, far, strict=True))))
    found = fit([make_drive(truth, 60.0, seed)], PLAIN, start=start)
    assert np.abs(_pulls(found, truth)).max() < 4.0


def test_circles_fix_two_sums_and_no_parameter(make_circles):
    found = fit(make_circles(), Model(STILL._replace(lf=0.15, lr=0.18, c_sf=5.0, c_sr=5.0)), TYRES)
    share = 1.0 / (PAPER_CAR.mu * 9.81)
    lf, lr, softer = PAPER_CAR.lf, PAPER_CAR.lr, share / PAPER_CAR.c_sf
    wanted = (lf + lr + softer - share / PAPER_CAR.c_sr, lr - share / PAPER_CAR.c_sr)
    assert [c.value for c in found.combinations] == pytest.approx(wanted, rel=2e-3)
    open_ = {name: e for name, e in found.estimates.items() if not e.identifiable}
    assert {"c_sf", "c_sr"} <= set(open_)
    assert all(e.manoeuvre for e in open_.values())


@pytest.mark.parametrize("stiffness", [(3.15, 9.6), (6.7, 4.1), (8.0, 6.3)])
def test_circles_from_a_far_start_tell_no_length_either(make_circles, stiffness):
    base = STILL._replace(lf=0.24, lr=0.31, c_sf=stiffness[0], c_sr=stiffness[1])
    found = fit(make_circles(), Model(base), TYRES)
    assert not any(e.identifiable for e in found.estimates.values())


def test_circles_do_not_tell_the_sum_that_hangs_on_the_steering_gain(make_circles):
    runs, wide = make_circles(), Model(STILL._replace(steer_min=-0.6, steer_max=0.6))
    assert all(c.known for c in fit(runs, wide, TYRES).combinations)
    first, second = fit(runs, wide, (*TYRES, "steer_gain")).combinations
    assert not first.known
    assert first.sd > 0.02 * first.value
    assert second.known


def test_known_wheelbase_is_kept(make_drive):
    model = Model(DEFAULT_CAR._replace(lf=0.2, lr=0.1302))
    found = fit([make_drive(PLAIN, 12.0, 5)], model, TYRES, wheelbase=0.3302)
    assert found.model.car.lf + found.model.car.lr == pytest.approx(0.3302, abs=1e-12)
    assert found.estimates["lf"].value == pytest.approx(DEFAULT_CAR.lf, rel=0.02)
    assert found.estimates["lf"].sd == pytest.approx(found.estimates["lr"].sd)


def test_effects_are_fitted_with_the_car(make_drive):
    ((effect, values),) = parse_effects("steer_asymmetry=0.08")
    run = make_drive(Model(DEFAULT_CAR, (effect,), (values,)), 12.0, 6)
    name = f"steer_asymmetry.{effect.parameters[0].name}"
    found = fit([run], Model(DEFAULT_CAR, (effect,), ((0.0,),)), (*TYRES, name))
    estimate = found.estimates[name]
    assert abs(estimate.value - 0.08) < 4.0 * estimate.sd
    assert estimate.identifiable
    assert (found.model.effects, found.model.values) == ((effect,), ((estimate.value,),))


def test_outliers_do_not_pull(make_drive, truth):
    clean, rng = make_drive(truth, 24.0, 2), np.random.default_rng(0)
    poses = clean.pose.values.copy()
    poses[rng.choice(len(poses), 10, replace=False), :2] += rng.normal(size=(10, 2)) * 0.2
    drives = clean, replace(clean, pose=Signal(clean.pose.t, poses))
    a, b = (fit([run], PLAIN, wheelbase=0.332).estimates for run in drives)
    for name in TYRES:
        assert abs(a[name].value - b[name].value) < 3.0 * b[name].sd


def _moved(run, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    x, y, yaw = run.pose.values.T
    pose = np.column_stack([c * x - s * y + shift[0], s * x + c * y + shift[1], yaw + angle])
    return replace(run, pose=Signal(run.pose.t, pose))


def test_neither_place_nor_heading_nor_order_matters(make_drive):
    runs = [make_drive(PLAIN, 6.0, s) for s in (11, 12)]
    start = Model(DEFAULT_CAR._replace(c_sf=4.0, lr=0.18))
    turned = [_moved(run, 2.1, (30.0, -7.0)) for run in runs]
    plain, *others = (fit(each, start, TYRES).estimates for each in (runs, turned, runs[::-1]))
    for other in others:
        for name, estimate in plain.items():
            assert abs(other[name].value - estimate.value) < 0.2 * estimate.sd


def test_measured_speed_is_prescribed_where_no_command_exists(make_drive, truth):
    run = make_drive(truth, 12.0, 4)
    t = np.arange(len(run.commands)) * run.h
    bare = make_run("bare", Signal(t, run.commands[:, 0]), None, run.pose, wheel=run.wheel)
    assert bare.speed_source == "wheel"
    start = truth._replace(car=truth.car._replace(speed_gain=1.0, c_sf=6.0))
    found = fit([bare], start, (*TYRES, "speed_gain", "speed_lag"))
    assert "speed_lag" not in found.estimates
    assert found.estimates["speed_gain"].value == pytest.approx(1.02, rel=3e-3)


def test_a_speed_that_never_changes_tells_nothing_of_its_loop_nor_a_name_that_is_none(
    make_drive, truth
):
    run = make_drive(truth, 20.0, 3, speed=1.5)
    found = fit([run], PLAIN)
    lag = found.estimates["speed_lag"]
    open_lag = (DEFAULT_CAR.speed_lag, SPREAD["speed_lag"], False)
    assert (lag.value, lag.sd, lag.identifiable) == open_lag
    assert "never changed" in lag.manoeuvre
    assert found.estimates["speed_gain"].identifiable
    with pytest.raises(DataError, match="never changed"):
        plain_car.free_of([run], ("speed_lag", "drive_delay"))
    with pytest.raises(ValueError, match="c_sx"):
        fit([run], PLAIN, ("c_sx",))


def test_noise_that_hangs_together_widens_the_errors(make_drive):
    """Pose noise that forgets slowly, as large as the white one."""
    run, share = make_drive(PLAIN, 30.0, 4), 0.98
    plain = fit([run], PLAIN, TYRES).estimates
    white = np.random.default_rng([5, 4]).normal(size=(len(run.pose.t), 2)) * 1e-3
    pose = run.pose.values.copy()
    pose[:, :2] += lfilter([np.sqrt(1.0 - share**2)], [1.0, -share], white, axis=0)
    slow = fit([replace(run, pose=Signal(run.pose.t, pose))], PLAIN, TYRES).estimates
    assert np.median([slow[n].sd / plain[n].sd for n in TYRES]) > 1.2
    for name, estimate in slow.items():
        assert abs(estimate.value - getattr(DEFAULT_CAR, name)) < 3.0 * estimate.sd, name


def test_a_doubt_adds_what_a_wrong_value_does(make_drive):
    run, wrong = make_drive(PLAIN, 20.0, 2), 2e-4
    names = (*TYRES, "steer_lag", "speed_lag")
    plain = fit([run], PLAIN, names).estimates
    late = fit([run], Model(DEFAULT_CAR._replace(pose_delay=wrong)), names).estimates
    doubtful = fit([run], PLAIN, names, doubts=(("pose_delay", wrong),)).estimates
    moved = {n: abs(late[n].value - plain[n].value) for n in names}
    shown = [n for n in names if moved[n] > 1.5 * plain[n].sd]
    assert shown
    for name in shown:
        before, after = plain[name], doubtful[name]
        added = np.sqrt(after.sd**2 - before.sd**2)
        assert added == pytest.approx(moved[name], rel=0.2)
        assert after.value == before.value
    found = fit([run], PLAIN, (*TYRES, "steer_delay"), doubts=(("steer_delay", 3e-3),))
    assert found.estimates["steer_delay"].sd == pytest.approx(3e-3, rel=0.02), "its own doubt"


def test_slow_driving_and_stiff_cars_get_more_steps():
    assert stable_substeps(DEFAULT_CAR, 1.0, 3.0, 0.01) == 1
    assert stable_substeps(DEFAULT_CAR, 0.0, 3.0, 0.01) == 2
    stiff = DEFAULT_CAR._replace(lf=0.324, lr=0.324, c_sf=7.0, c_sr=7.0)
    assert stable_substeps(stiff, 1.0, 1.0, 0.01) > 2


def _forward(model, speed, accel, steer):
    """Speed of the body along its x axis [m/s]."""
    state = State(0.0, 0.0, 0.0, speed, 2.0 * steer, 0.1 * steer, steer)
    return derivative(model.chassis, FLOAT, model.car, state, steer, accel).x


@given(speed=st.floats(0.5, 4.0), accel=st.floats(-5.0, 5.0), steer=st.floats(-0.3, 0.3))
def test_a_speed_from_poses_is_the_bodys_and_one_from_wheels_theirs(minute, speed, accel, steer):
    planar = Model(DEFAULT_CAR, chassis=make_planar("all"))
    assert prescribe_speed(planar, [minute]) is prescribe_speed(planar, []) is planar
    posed = prescribe_speed(planar, [replace(minute, speed_source="pose")])
    assert _forward(posed, speed, accel, steer) == pytest.approx(speed, abs=2e-5)
    rolled = prescribe_speed(planar, [replace(minute, speed_source="wheel")])
    assert _forward(rolled, speed, 4.0, 0.0) < 0.99 * speed, "wheels that drive slip"
