"""Parts, validation, excitation and the whole way from drives to an outcome."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis.identify_report import make_report
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.excitation import measure_excitation
from steerd.sysid.data.segments import (
    hold_out,
    make_segment,
    moving_segments,
    smooth_speed,
    with_wheel_speed,
)
from steerd.sysid.estimation import preparation as prep
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import REPORTED, encode_outcome
from steerd.sysid.estimation.validation import HORIZONS, errors_at, trace_windows
from steerd.sysid.report.design_comparison import compare_designs
from steerd.sysid.report.page import render_report

pytestmark = pytest.mark.slow

FREE = ("lf", "lr", "c_sf", "c_sr", "steer_gain", "speed_gain", "speed_lag", "steer_lag")
DEFAULT = Model(DEFAULT_CAR)


@pytest.fixture(scope="module")
def run(make_drive, truth):
    return make_drive(truth, 30.0, 5)


@pytest.fixture(scope="module")
def outcome(run):
    return learn(Task((run,), DEFAULT, prep.FitOptions(wheelbase=0.332)), lambda: 0.0)


def test_a_part_keeps_commands_and_measurements_together(run):
    part = make_segment(run, 10.0, 14.0)
    assert part.pose.t[0] == pytest.approx(0.5)
    first = round(9.5 / run.h)
    np.testing.assert_array_equal(part.commands, run.commands[first : first + len(part.commands)])
    at = np.searchsorted(run.pose.t, 10.0 - 1e-9)
    np.testing.assert_array_equal(part.pose.values[0], run.pose.values[at])


def test_too_little_to_keep_back_is_said(make_drive, truth):
    with pytest.raises(DataError, match="too short to hold"):
        hold_out(moving_segments([make_drive(truth, 6.0, 1)]), 4)


def test_wheel_speed_in_the_commands_place(run):
    taken = with_wheel_speed(run)
    assert taken.speed_source == "wheel"
    assert np.corrcoef(taken.commands[100:-100, 1], run.commands[100:-100, 1])[0, 1] > 0.8
    rough, smooth = taken.commands[:, 1], smooth_speed(taken).commands[:, 1]
    assert np.std(np.diff(smooth)) < 0.3 * np.std(np.diff(rough))
    with pytest.raises(DataError, match="no wheel speed"):
        with_wheel_speed(replace(run, wheel=type(run.wheel)(np.empty(0), np.empty(0))))


def test_the_true_car_predicts_to_the_noise_and_a_wrong_one_does_not(run, truth):
    other = truth._replace(car=truth.car._replace(steer_gain=0.85))
    traces = (trace_windows(model, [run], max(HORIZONS)) for model in (truth, other))
    true, wrong = (errors_at(each, HORIZONS) for each in traces)
    assert true[-1].position < 0.012
    for a, b in pairwise(p.position for p in wrong):
        assert a < b
    assert wrong[-1].position > 10.0 * true[-1].position
    assert all(p.median <= p.position for p in true)


def test_excitation_tells_rich_from_poor(run, make_circles):
    assert measure_excitation([run]).lacking == ()
    poor = measure_excitation(make_circles(2, 4.0)[:1])
    assert any("one speed" in what for what in poor.lacking)
    assert any("one side" in what for what in poor.lacking)


def test_learning_recovers_the_car_and_predicts_better(outcome, truth):
    row = outcome.rows["steer_gain"]
    assert row.value == pytest.approx(truth.car.steer_gain, rel=0.05)
    assert row.identifiable
    assert outcome.held_out[-1].factor > 3.0


def test_json_is_the_schema(outcome):
    encoded = encode_outcome(outcome)
    assert encoded["schema"] == "steerd.identify/1"
    assert tuple(encoded["parameters"]) == REPORTED
    assert {tuple(p) for p in encoded["parameters"].values()} == {
        ("value", "sd", "unit", "identifiable")
    }
    assert encoded["parameters"]["mass"]["sd"] is None
    assert encoded["converged"] is True
    assert encoded["misfit"] == outcome.fit.misfit
    assert encoded["notes"] == list(outcome.notes)
    assert set(encoded["held_out"]["horizons"][0]) == {
        "horizon", "position", "median", "heading",
        "position_before", "median_before", "heading_before",
    }  # fmt: skip


def test_the_report_needs_nothing_else(outcome, truth, monkeypatch):
    monkeypatch.setattr("steerd.sysid.report.design_comparison.SECONDS", 2.0)
    monkeypatch.setattr("steerd.sysid.report.design_comparison.FRICTIONS", {"standard": 1.0})
    monkeypatch.setattr(
        "steerd.sysid.report.design_comparison.compare_designs",
        lambda plant, cars: compare_designs(plant, {"true": plant}),
    )
    page = render_report(make_report(replace(outcome, truth=truth.car)))
    assert page.count("<figure") == 5
    for outside in ("<script", "stylesheet", "<img", "src=", "@import"):
        assert outside not in page
    assert "not fitted" in page
    assert "<th>true</th>" in page


def test_the_papers_method_tells_its_spread(make_circles):
    runs = tuple(make_circles(4, 2.5))
    asked = prep.FitOptions(method="paper", starts=2, iterations=4)
    task = Task(runs[:3], DEFAULT, asked, runs[3:])
    outcome = learn(task, lambda: 0.0)
    assert len(outcome.searches) == 2
    assert outcome.rows["c_sf"].sd > 0.0
    assert not outcome.rows["c_sf"].identifiable
    assert outcome.fit is None


def test_further_starts_lie_about_the_first():
    models = prep.scatter(DEFAULT, FREE, 20, seed=1)
    assert models[0] == DEFAULT
    factors = np.array([m.car.c_sf / DEFAULT.car.c_sf for m in models[1:]])
    assert 0.1 < np.std(np.log(factors)) < 0.5
    assert all(m.car.mass == DEFAULT.car.mass for m in models)


def test_a_fixed_length_and_the_wheelbase_make_the_other():
    car = prep.fit_wheelbase(DEFAULT._replace(car=DEFAULT_CAR._replace(lr=0.2)), 0.33, ["lr"]).car
    assert (car.lf, car.lr) == (pytest.approx(0.13), 0.2)
    free = ("lf", "lr", "c_sf")
    assert prep.free_names(prep.FitOptions(fix={"lr": None}, wheelbase=0.33), free) == ("c_sf",)
    assert prep.free_names(prep.FitOptions(fix={"lr": None}), free) == ("lf", "c_sf")
    assert prep.free_names(prep.FitOptions(wheelbase=0.33), free) == free
    agreed = DEFAULT._replace(car=DEFAULT_CAR._replace(lf=0.15, lr=0.18))
    assert prep.fit_wheelbase(agreed, 0.33, ["lf", "lr"]) == agreed
    with pytest.raises(ValueError, match="do not make a wheelbase"):
        prep.fit_wheelbase(agreed._replace(car=agreed.car._replace(lf=0.1)), 0.33, ["lf", "lr"])


def test_drives_with_and_without_speed_commands_are_not_one_fit(run, truth):
    bare = replace(with_wheel_speed(run), name="bare")
    with pytest.raises(DataError, match=r"bare has no speed commands, run 5 has.*--speed wheel"):
        learn(Task((run, bare), DEFAULT), lambda: 0.0)
    with pytest.raises(DataError, match="bare has no speed commands"):
        trace_windows(truth, [run, bare], max(HORIZONS))
    with pytest.raises(DataError, match="bare has no speed commands"):
        learn(Task((run,), DEFAULT, held_out=(bare,)), lambda: 0.0)


def _stepping(make, truth, faster):
    """Steps of steering at one speed, on a car whose servo is faster than the file says."""
    car = truth.car._replace(steer_rate=faster)
    t = np.arange(0.0, 24.0, 0.005)
    steer = 0.2 * np.sign(np.sin(4.0 * t))
    first = np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    return make(Model(car), np.column_stack([steer, np.full(len(t), 1.5)]), first, 2)


def test_a_slew_limit_that_nobody_measured_is_learnt_where_it_is_felt(simulated, truth):
    run = _stepping(simulated, truth, 7.0)
    task = Task((run,), DEFAULT, prep.FitOptions(wheelbase=0.332))
    found = learn(task, lambda: 0.0)
    for name, row in found.free_rows.items():
        if row.identifiable:
            assert abs(row.value - getattr(truth.car, name)) < 4.0 * row.sd, name
    sure = learn(replace(task, held=("steer_rate",)), lambda: 0.0)
    rate = found.rows["steer_rate"]
    assert abs(rate.value - 7.0) < 4.0 * rate.sd
    assert not sure.rows["steer_rate"].free


def test_what_keeps_its_value():
    assert prep.held_names(prep.FitOptions(wheelbase=0.33)) == ()
    assert prep.held_names(prep.FitOptions(fix={"mass": None})) == ("mass",)
    assert set(prep.held_names(prep.FitOptions(fix={"lf": 0.2}, wheelbase=0.33))) == {"lf", "lr"}
    held = prep.held_names(prep.FitOptions(free=("lr", "steer_gain")))
    assert "lf" in held
    assert "tyre_saturation" in held
    assert not {"lr", "steer_gain"} & set(held)
    follows = prep.held_names(prep.FitOptions(free=("lr",), wheelbase=0.33))
    assert not {"lf", "lr"} & set(follows), "of a known distance one length follows from the other"
    both = prep.held_names(prep.FitOptions(fix={"lf": None}, free=("lr",), wheelbase=0.33))
    assert {"lf", "lr"} <= set(both)
