"""Effects that drives show are found among candidates, and none where there is none."""

from dataclasses import replace

import pytest

from steerd.car_model.effects import find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.data.segments import make_blocks, moving_segments
from steerd.sysid.estimation.effect_selection import select_effects
from steerd.sysid.estimation.fit import Options, fit
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import encode_outcome
from steerd.sysid.estimation.prediction_horizon import (
    ROUGH,
    SHORT,
    add_command_history,
    is_adequate,
)

pytestmark = pytest.mark.slow

CANDIDATES = ("steer_asymmetry", "steer_backlash")
BENT = find_effect("steer_asymmetry")
OPTIONS = Options(free=("lf", "lr", "c_sf", "c_sr", "steer_gain", "steer_lag"), wheelbase=0.332)


@pytest.fixture(scope="module")
def bent(make_drive, truth):
    """A car that turns 16 % further to the left than to the right."""
    return make_drive(truth._replace(effects=(BENT,), values=((0.08,),)), 30.0, 5)


def _chosen(run, truth):
    parts = make_blocks(moving_segments(add_command_history([run], truth, CANDIDATES)))
    rough = fit(parts, truth, options=replace(OPTIONS, horizons=ROUGH))
    return select_effects(parts, rough, replace(OPTIONS, horizons=SHORT), CANDIDATES)


def test_an_effect_that_is_there_is_found_alone(bent, truth):
    selection = _chosen(bent, truth)
    assert [step.effect for step in selection.steps] == ["steer_asymmetry"]
    assert selection.free == ("steer_asymmetry.asymmetry",)
    assert selection.model.values[0][0] == pytest.approx(0.08, abs=0.01)
    assert selection.with_nulls(truth).values == ((0.0,),)


def test_a_car_without_effects_gets_none(make_drive, truth):
    selection = _chosen(make_drive(truth, 30.0, 6), truth)
    assert selection.steps == ()
    assert selection.model.effects == ()


def test_the_outcome_holds_the_effect_and_predicts_with_it(bent, truth):
    outcome = learn(Task((bent,), truth, options=OPTIONS, effects=CANDIDATES), lambda: 0.0)
    row = outcome.effect_rows["steer_asymmetry.asymmetry"]
    assert row.before == 0.0
    assert row.value == pytest.approx(0.08, abs=5 * row.sd)
    assert outcome.held_out[-1].factor > 3.0
    assert outcome.selected_effects[0].effect == "steer_asymmetry"
    page = encode_outcome(outcome)
    assert page["parameters"]["steer_asymmetry.asymmetry"]["identifiable"]
    assert sum(r["predictions"] for r in page["held_out"]["regimes"]) > 0


def test_a_model_that_misses_much_is_fitted_over_short_windows(make_drive, truth):
    run = make_drive(truth._replace(effects=(BENT,), values=((0.45,),)), 20.0, 5)
    parts = make_blocks(moving_segments([run]))
    assert not is_adequate(fit(parts, truth, options=replace(OPTIONS, horizons=ROUGH)))
    outcome = learn(Task((run,), truth, options=OPTIONS), lambda: 0.0)
    assert any("does not hold for longer" in note for note in outcome.notes)
    assert any("--effects auto" in note for note in outcome.notes)


def test_only_play_needs_a_long_past(bent):
    played = Model(DEFAULT_CAR, (find_effect("steer_backlash"),), ((0.02,),))
    assert add_command_history([bent], played, ())[0].history > bent.history
    assert (
        add_command_history([bent], Model(DEFAULT_CAR), ("mocap_yaw",))[0].history == bent.history
    )
