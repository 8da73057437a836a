"""Effects that drives show are learnt with the car, and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.effects import find_effect
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.estimation import preparation as prep
from steerd.sysid.estimation.learn import Task, learn
from steerd.sysid.estimation.outcome import encode_outcome

pytestmark = pytest.mark.slow

BENT, PLAY = find_effect("steer_asymmetry"), find_effect("steer_backlash")
FREE = ("lf", "lr", "c_sf", "c_sr", "steer_gain", "steer_lag")
ASKED = prep.FitOptions(wheelbase=0.332, effects=(BENT.name, PLAY.name))


@pytest.fixture(scope="module")
def bent(make_drive, truth):
    """A car that turns 16 % further to the left than to the right."""
    return make_drive(truth._replace(effects=(BENT,), values=((0.08,),)), 30.0, 5)


def _learnt(run, truth):
    return learn(Task((run,), truth, ASKED, free=FREE, held=prep.held_names(ASKED)), lambda: 0.0)


def test_a_bend_of_the_linkage_is_learnt_and_predicted_with(bent, truth):
    outcome = _learnt(bent, truth)
    (name,) = (name for name in outcome.rows if "." in name)
    assert name == "steer_asymmetry.asymmetry"
    row = outcome.rows[name]
    assert row.start == 0.0
    assert row.value == pytest.approx(0.08, abs=min(0.01, 5 * row.sd))
    assert outcome.held_out[-1].factor > 3.0
    page = encode_outcome(outcome)
    assert page["parameters"][name]["identifiable"]
    assert sum(r["predictions"] for r in page["held_out"]["regimes"]) > 0


@pytest.mark.parametrize("play", [0.04, 0.0])
def test_play_that_no_car_has_by_itself_is_selected_where_there_is_some(make_drive, truth, play):
    effects, values = ((PLAY,), ((play,),)) if play else ((), ())
    outcome = _learnt(make_drive(truth._replace(effects=effects, values=values), 30.0, 5), truth)
    assert [step.effect for step in outcome.fit.selected] == [effect.name for effect in effects]
    assert all(step.gain > 3.0 for step in outcome.fit.selected)
    rows = [row for name, row in outcome.rows.items() if "." in name]
    assert [row.value for row in rows] == [
        pytest.approx(play, abs=min(0.008, 5 * row.sd)) for row in rows[: len(effects)]
    ]


def test_a_car_that_misses_much_is_said_to(make_drive, truth):
    run = make_drive(truth._replace(effects=(BENT,), values=((0.45,),)), 20.0, 5)
    none = (*prep.held_names(ASKED), BENT.name, PLAY.name)
    outcome = learn(Task((run,), truth, ASKED, free=FREE, held=none), lambda: 0.0)
    assert any("`steerd diagnose` looks for it" in note for note in outcome.notes)


def test_only_play_needs_a_long_past_and_is_asked_of_drives_that_rest(bent):
    turning = replace(bent, commands=bent.commands + np.arange(len(bent.commands))[:, None] * 0.01)
    for run, effects, longer in (
        (turning, (PLAY,), True), (bent, (), True), (turning, (), False),
    ):  # fmt: skip
        model = Model(DEFAULT_CAR, effects, ((0.02,),) * len(effects))
        (found,) = prep.add_command_history([run], model)
        assert (found.history > run.history) == longer
