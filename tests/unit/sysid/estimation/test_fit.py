"""The fit finds injected truth, says how sure it is, and says what it cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.car_model.chassis import derivative
from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model
from steerd.car_model.native.windows import parameter_vector
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.planar import make_planar
from steerd.car_model.state import State
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.inference.chart import make_chart
from steerd.sysid.estimation.fit import DEFAULT_FREE, TYRES, Options, fit, prescribe_speed
from steerd.sysid.inference.identifiability import directions, estimates
from steerd.sysid.inference.stability import stable_substeps

SLID = (0.18917528114233922, 0.29462271010112046, 5.025340279936621, 2.177483451231206)
"""Lengths and stiffnesses of a start in the long valley of long, sliding cars that steer more."""


def _pulls(found, truth):
    values = truth.car._asdict()
    return np.array([(e.value - values[name]) / e.sd for name, e in found.estimates.items()])


@pytest.fixture(scope="module")
def minute(make_drive, truth):
    return make_drive(truth, 60.0, 1)


def test_a_minute_of_driving_tells_eleven_parameters(minute, truth):
    found = fit([minute], Model(DEFAULT_CAR))
    assert found.converged
    assert set(found.estimates) == set(DEFAULT_FREE)
    assert np.abs(_pulls(found, truth)).max() < 4.0
    for name in TYRES:
        assert found.estimates[name].value == pytest.approx(truth.car._asdict()[name], rel=3e-3)
    assert not found.unidentified
    assert all(0.9 < ratio < 1.1 for ratio in found.misfit.values())
    assert found.noise[:2] == pytest.approx([1e-3, 2e-3], rel=0.05)
    assert np.allclose(np.diag(found.correlation), 1.0)


@pytest.mark.slow
def test_errors_have_the_size_that_the_fit_claims(make_drive, truth):
    pulls = [_pulls(fit([make_drive(truth, 12.0, s)], Model(DEFAULT_CAR)), truth) for s in range(5)]
    rms = float(np.sqrt(np.mean(np.square(pulls))))
    assert 0.6 < rms < 1.3


@pytest.mark.parametrize("seed", range(4))
def test_any_start_leads_to_the_same_car(make_drive, seed):
    run = make_drive(Model(DEFAULT_CAR), 8.0, 3)
    rng = np.random.default_rng(seed)
    drawn = dict(zip(TYRES, [*rng.uniform(0.1, 0.35, 2), *rng.uniform(2.0, 10.0, 2)], strict=True))
    options = Options(free=TYRES)
    found = fit(
        [run], Model(DEFAULT_CAR), options=options, starts=[Model(DEFAULT_CAR._replace(**drawn))]
    )
    assert np.abs(_pulls(found, Model(DEFAULT_CAR))).max() < 4.5


def test_circles_fix_two_sums_and_no_parameter(make_circles):
    base = PAPER_CAR._replace(
        steer_delay=0.0, steer_lag=0.0, steer_rate=1e3, speed_lag=0.0, accel_max=1e3,
        decel_max=1e3, lf=0.15, lr=0.18, c_sf=5.0, c_sr=5.0,
    )  # fmt: skip
    found = fit(make_circles(), Model(base), options=Options(free=TYRES))
    share = 1.0 / (PAPER_CAR.mu * 9.81)
    wanted = (
        PAPER_CAR.lf + PAPER_CAR.lr + share * (1 / PAPER_CAR.c_sf - 1 / PAPER_CAR.c_sr),
        PAPER_CAR.lr - share / PAPER_CAR.c_sr,
    )
    assert [c.value for c in found.combinations] == pytest.approx(wanted, rel=1e-3)
    assert {"c_sf", "c_sr"} <= set(found.unidentified)
    assert sum(d.identifiable for d in found.directions) == 2
    assert all(found.estimates[name].manoeuvre for name in found.unidentified)


@pytest.mark.parametrize("stiffness", [(3.15, 9.6), (6.7, 4.1), (8.0, 6.3)])
def test_circles_from_a_far_start_tell_no_length_either(make_circles, stiffness):
    base = PAPER_CAR._replace(
        steer_delay=0.0, steer_lag=0.0, steer_rate=1e3, speed_lag=0.0, accel_max=1e3,
        decel_max=1e3, lf=0.24, lr=0.31, c_sf=stiffness[0], c_sr=stiffness[1],
    )  # fmt: skip
    found = fit(make_circles(), Model(base), options=Options(free=TYRES))
    assert set(found.unidentified) == set(TYRES)


@pytest.mark.parametrize("far", [(0.325, 0.214, 2.939, 2.824), (0.324, 0.324, 7.0, 7.0)])
def test_a_start_in_the_long_valley_of_similar_cars_arrives(make_drive, truth, far):
    run = make_drive(truth, 60.0, 4 if far[2] < 3.0 else 80)
    start = Model(DEFAULT_CAR._replace(**dict(zip(TYRES, far, strict=True))))
    found = fit([run], Model(DEFAULT_CAR), starts=[start])
    assert found.evaluations < 60
    assert np.abs(_pulls(found, truth)).max() < 4.0


def test_known_wheelbase_is_kept(make_drive):
    run = make_drive(Model(DEFAULT_CAR), 8.0, 5)
    options = Options(free=TYRES, wheelbase=0.3302)
    found = fit([run], Model(DEFAULT_CAR._replace(lf=0.2, lr=0.1302)), options=options)
    assert found.model.car.lf + found.model.car.lr == pytest.approx(0.3302, abs=1e-12)
    assert found.estimates["lf"].value == pytest.approx(DEFAULT_CAR.lf, rel=0.02)
    assert found.estimates["lf"].sd == pytest.approx(found.estimates["lr"].sd)


@pytest.mark.slow
def test_effects_are_fitted_with_the_car(make_drive):
    ((effect, values),) = parse_effects("steer_asymmetry=0.08")
    run = make_drive(Model(DEFAULT_CAR, (effect,), (values,)), 10.0, 6)
    start = Model(DEFAULT_CAR, (effect,), ((0.0,),))
    name = f"steer_asymmetry.{effect.parameters[0].name}"
    found = fit([run], start, options=Options(free=(*TYRES, name)))
    estimate = found.estimates[name]
    assert abs(estimate.value - 0.08) < 4.0 * estimate.sd
    assert estimate.identifiable
    assert found.model.effects == (effect,)


def test_outliers_do_not_pull(make_drive, truth):
    clean = make_drive(truth, 12.0, 2)
    rng = np.random.default_rng(0)
    poses = clean.pose.values.copy()
    hit = rng.choice(len(poses), len(poses) // 50, replace=False)
    poses[hit, :2] += rng.normal(size=(len(hit), 2)) * 0.2
    dirty = Run(clean.name, clean.h, clean.commands, Signal(clean.pose.t, poses), wheel=clean.wheel)
    a, b = (
        fit([run], Model(DEFAULT_CAR), options=Options(noise=(1e-3, 2e-3, 0.02, 1.0)))
        for run in (clean, dirty)
    )
    for name in TYRES:
        assert abs(a.estimates[name].value - b.estimates[name].value) < 2.0 * a.estimates[name].sd


def _moved(run, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    x, y, yaw = run.pose.values.T
    pose = np.column_stack([c * x - s * y + shift[0], s * x + c * y + shift[1], yaw + angle])
    return Run(run.name, run.h, run.commands, Signal(run.pose.t, pose), wheel=run.wheel)


def test_neither_place_nor_heading_nor_order_matters(make_drive):
    runs = [make_drive(Model(DEFAULT_CAR), 5.0, s) for s in (11, 12)]
    options = Options(free=TYRES, noise=(1e-3, 2e-3, 0.02, 1.0))
    start = Model(DEFAULT_CAR._replace(c_sf=4.0, lr=0.18))
    plain = fit(runs, start, options=options)
    turned = fit([_moved(run, 2.1, (30.0, -7.0)) for run in runs], start, options=options)
    swapped = fit(runs[::-1], start, options=options)
    for name in TYRES:
        sd = plain.estimates[name].sd
        for other in (turned, swapped):
            assert abs(other.estimates[name].value - plain.estimates[name].value) < 0.1 * sd


def test_measured_speed_is_prescribed_where_no_command_exists(make_drive, truth):
    run = make_drive(truth, 10.0, 4)
    t = np.arange(len(run.commands)) * run.h
    bare = make_run(
        "no speed command", Signal(t, run.commands[:, 0]), None, run.pose, wheel=run.wheel
    )
    assert bare.speed_source == "wheel"
    found = fit(
        [bare], Model(DEFAULT_CAR), options=Options(free=(*TYRES, "speed_gain", "speed_lag"))
    )
    assert "speed_lag" not in found.estimates
    assert found.estimates["speed_gain"].value == pytest.approx(1.02, rel=3e-3)


def test_one_constant_steering_is_refused(simulated):
    commands = np.column_stack([np.full(400, 0.1), np.ones(400)])
    first = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.1])
    with pytest.raises(DataError, match="constant"):
        fit([simulated(Model(DEFAULT_CAR), commands, first, 0)], Model(DEFAULT_CAR))


def test_unknown_names_are_refused(make_drive):
    with pytest.raises(ValueError, match="c_sx"):
        fit(
            [make_drive(Model(DEFAULT_CAR), 2.0, 0)],
            Model(DEFAULT_CAR),
            options=Options(free=("c_sx",)),
        )


def test_slow_driving_and_stiff_cars_get_more_steps():
    assert stable_substeps(DEFAULT_CAR, 1.0, 3.0, 0.01) == 1
    assert stable_substeps(DEFAULT_CAR, 0.0, 3.0, 0.01) == 2
    assert (
        stable_substeps(
            DEFAULT_CAR._replace(lf=0.324, lr=0.324, c_sf=7.0, c_sr=7.0), 1.0, 1.0, 0.01
        )
        > 2
    )


def test_a_rough_fit_that_misses_tries_other_starts(make_drive, truth):
    """From here short windows lead into another minimum, 300 standard errors away."""
    start = DEFAULT_CAR._replace(**dict(zip(TYRES, SLID, strict=True)))
    found = fit([make_drive(truth, 60.0, 6072)], Model(DEFAULT_CAR), starts=[Model(start)])
    assert found.misfit["position"] < 1.1
    assert found.model.car.c_sf == pytest.approx(truth.car.c_sf, rel=5e-3)


def test_noise_that_passes_for_transients_tells_no_compliance():
    """Known to a third of itself, after a start with tyres three times as soft."""
    p = parameter_vector(Model(DEFAULT_CAR._replace(c_sf=3.0)))
    chart = make_chart((), p, TYRES)
    z = chart.coordinates(parameter_vector(Model(DEFAULT_CAR._replace(c_sf=9.0))))
    sd = np.array([1e-5, 1e-5, 0.3 * z[2], 1e-3])
    identifiable = {d.text: d.identifiable for d in directions(chart, z, np.diag(sd**-2))}
    assert sum(identifiable.values()) == 3
    assert not estimates(chart, z, np.diag(sd**2))["c_sf"].identifiable


def test_nothing_is_told_while_a_length_sits_at_its_bound():
    names = ("lf", "lr", "inertia_z")
    prior = parameter_vector(Model(DEFAULT_CAR))
    chart = make_chart((), prior, names, 0.33)
    small = np.diag([1e-4, 1e-4]) ** 2
    for lr, told in ((0.17, True), (0.325, False)):
        z = chart.coordinates(parameter_vector(Model(DEFAULT_CAR._replace(lr=lr))))
        found = estimates(chart, z, small)
        assert all(e.identifiable is told for e in found.values())
        assert all(("at its bound" in e.manoeuvre) is not told for e in found.values())


def test_a_speed_that_is_never_changed_tells_nothing_of_its_loop(make_drive, truth):
    run = make_drive(truth, 20.0, 3, speed=1.5)
    found = fit([run], Model(DEFAULT_CAR))
    lag = found.estimates["speed_lag"]
    assert not lag.identifiable
    assert lag.value == DEFAULT_CAR.speed_lag
    assert lag.sd == lag.prior_sd
    assert "never changed" in lag.manoeuvre
    assert found.estimates["speed_gain"].identifiable
    with pytest.raises(DataError, match="never changed"):
        fit([run], Model(DEFAULT_CAR), options=Options(free=("speed_lag", "drive_delay")))


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
