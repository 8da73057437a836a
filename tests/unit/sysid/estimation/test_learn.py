"""Parts, validation, excitation and the whole way from drives to an outcome."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from steerd.car_model.effects import find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis.identify_report import make_report
from steerd.sysid.data import segments
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.excitation import measure_excitation
from steerd.sysid.estimation import preparation as prep
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import REPORTED, encode_outcome, make_rows
from steerd.sysid.estimation.validation import HORIZONS, errors_at, trace_windows
from steerd.sysid.report.design_comparison import compare_designs
from steerd.sysid.report.page import render_report

pytestmark = pytest.mark.slow

FREE = ("lf", "lr", "c_sf", "c_sr", "steer_gain", "speed_gain", "speed_lag", "steer_lag")
DEFAULT = Model(DEFAULT_CAR)

run = pytest.fixture(lambda make_drive, truth: make_drive(truth, 30.0, 5), scope="module")


@pytest.fixture(scope="module")
def outcome(run):
    return learn(Task((run,), DEFAULT, prep.FitOptions(wheelbase=0.332)), lambda: 0.0)


def test_too_little_to_hold_out_is_said(make_drive, truth):
    with pytest.raises(DataError, match="too short to hold"):
        segments.hold_out(segments.moving_segments([make_drive(truth, 6.0, 1)]), 4)


def test_wheel_speed_in_the_commands_place(run):
    taken = segments.with_wheel_speed(run)
    assert taken.speed_source == "wheel"
    assert np.corrcoef(taken.commands[100:-100, 1], run.commands[100:-100, 1])[0, 1] > 0.8
    rough, smooth = taken.commands[:, 1], segments.smooth_speed(taken).commands[:, 1]
    assert np.std(np.diff(smooth)) < 0.3 * np.std(np.diff(rough))
    with pytest.raises(DataError, match="no wheel speed"):
        segments.with_wheel_speed(replace(run, wheel=type(run.wheel)(np.empty(0), np.empty(0))))


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


def test_learning_recovers_the_car_predicts_better_and_its_json_is_the_schema(outcome, truth):
    row = outcome.rows["steer_gain"]
    assert row.value == pytest.approx(truth.car.steer_gain, rel=0.05)
    assert row.identifiable
    assert outcome.held_out[-1].factor > 3.0
    assert (outcome.pulses, outcome.ramps) == ((), ()), "no servo is known to be pulsed"
    encoded = encode_outcome(outcome)
    assert (encoded["schema"], tuple(encoded["parameters"])) == ("steerd.identify/1", REPORTED)
    keys = ("value", "sd", "unit", "identifiable")
    assert {tuple(p) for p in encoded["parameters"].values()} == {keys}
    assert encoded["parameters"]["mass"]["sd"] is None
    assert encoded["converged"] is True
    assert (encoded["misfit"], encoded["notes"]) == (outcome.fit.misfit, list(outcome.notes))
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
    outcome = learn(Task(runs[:3], DEFAULT, asked, runs[3:]), lambda: 0.0)
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


def test_a_fixed_length_and_the_wheelbase_make_the_other_and_what_is_fixed_keeps_its_value():
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


def test_drives_with_and_without_speed_commands_are_not_one_fit(run):
    bare = replace(segments.with_wheel_speed(run), name="bare")
    with pytest.raises(DataError, match=r"bare has no speed commands, run 5 has.*--speed wheel"):
        learn(Task((run, bare), DEFAULT), lambda: 0.0)
    with pytest.raises(DataError, match="bare has no speed commands"):
        learn(Task((run,), DEFAULT, held_out=(bare,)), lambda: 0.0)


def test_a_slew_limit_that_nobody_measured_is_learnt_where_it_is_felt(simulated, truth):
    """Steps of steering at one speed, on a car whose servo is faster than the file says."""
    t, first = np.arange(0.0, 24.0, 0.005), np.array([0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    commands = np.column_stack([0.2 * np.sign(np.sin(4.0 * t)), np.full(len(t), 1.5)])
    run = simulated(Model(truth.car._replace(steer_rate=7.0)), commands, first, 2)
    task = Task((run,), DEFAULT, prep.FitOptions(wheelbase=0.332))
    found = learn(task, lambda: 0.0)
    for name, row in found.free_rows.items():
        if row.identifiable:
            assert abs(row.value - getattr(truth.car, name)) < 4.0 * row.sd, name
    sure = learn(replace(task, free=("lf", "lr"), held=("steer_rate",)), lambda: 0.0)
    rate = found.rows["steer_rate"]
    assert abs(rate.value - 7.0) < 4.0 * rate.sd
    assert not sure.rows["steer_rate"].free


# Effects that drives show are learnt with the car, and none where there is none.
BENT, PLAY, STOP = map(find_effect, ("steer_asymmetry", "steer_backlash", "steer_clip"))
MANNERS_FREE = ("lf", "lr", "c_sf", "c_sr", "steer_gain", "steer_lag")
ASKED = prep.FitOptions(wheelbase=0.332, effects=(BENT.name, PLAY.name, STOP.name))


@pytest.fixture(scope="module")
def bent(make_drive, truth):
    """A car that turns 16 % further to the left than to the right."""
    return make_drive(truth._replace(effects=(BENT,), values=((0.08,),)), 30.0, 5)


def _learnt(run, truth):
    held = prep.held_names(ASKED)
    return learn(Task((run,), truth, ASKED, free=MANNERS_FREE, held=held), lambda: 0.0)


def test_a_bend_of_the_linkage_is_learnt_and_predicted_with(bent, truth):
    outcome = _learnt(bent, truth)
    (name,) = (name for name in outcome.rows if "." in name)
    assert name == "steer_asymmetry.asymmetry"
    row = outcome.rows[name]
    assert (row.start, row.value) == (0.0, pytest.approx(0.08, abs=min(0.01, 5 * row.sd)))
    assert outcome.held_out[-1].factor > 3.0
    page = encode_outcome(outcome)
    assert page["parameters"][name]["identifiable"]
    assert sum(r["predictions"] for r in page["held_out"]["regimes"]) > 0


@pytest.mark.parametrize(("effect", "size"), [(PLAY, 0.04), (STOP, 0.3), (None, 0.0)])
def test_what_no_car_has_by_itself_is_selected_where_there_is_some(make_drive, truth, effect, size):
    effects, values = ((effect,), ((size,),)) if effect else ((), ())
    outcome = _learnt(make_drive(truth._replace(effects=effects, values=values), 30.0, 59), truth)
    assert [step.effect for step in outcome.fit.selected] == [effect.name for effect in effects]
    assert all(step.gain > 3.0 for step in outcome.fit.selected)
    rows = [row for name, row in outcome.rows.items() if "." in name]
    near = [pytest.approx(size, abs=min(0.008, 5 * row.sd)) for row in rows[: len(effects)]]
    assert [row.value for row in rows] == near


def test_a_car_that_misses_much_is_said_to(make_drive, truth):
    bent = truth._replace(effects=(BENT,), values=((0.45,),))
    run = make_drive(bent, 20.0, 5)
    none = (*prep.held_names(ASKED), BENT.name, PLAY.name, STOP.name)
    outcome = learn(Task((run,), truth, ASKED, free=MANNERS_FREE, held=none), lambda: 0.0)
    assert any("`steerd diagnose` looks for it" in note for note in outcome.notes)
    assert make_rows(bent, truth, {})["steer_asymmetry.asymmetry"][:3] == (0.0, 0.45, None)


def test_only_play_needs_a_long_past_and_is_asked_of_drives_that_rest(bent):
    turning = replace(bent, commands=bent.commands + np.arange(len(bent.commands))[:, None] * 0.01)
    for run, effects, longer in ((turning, (PLAY,), True), (bent, (), True), (turning, (), False)):
        model = Model(DEFAULT_CAR, effects, ((0.02,),) * len(effects))
        (found,) = prep.add_command_history([run], model)
        assert (found.history > run.history) == longer
