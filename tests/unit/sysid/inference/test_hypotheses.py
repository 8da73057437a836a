"""Which effects: what is free, what may not be worse than what, and what is named."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

from steerd.car_model.effects import EFFECTS
from steerd.sysid.inference import constants as c
from steerd.sysid.inference import hypotheses
from steerd.sysid.inference.augmented_car import BasePrior, Control, make_augmented_car
from steerd.sysid.inference.hypotheses import begin, explain, screen_effects
from steerd.sysid.inference.library import Library, carry
from steerd.sysid.inference.odds import rank
from steerd.sysid.inference.posterior import posterior_of
from steerd.sysid.inference.search import minimise, stand
from steerd.sysid.inference.space import FLOORS, make_space, nuisance_names
from tests.unit.sysid.inference.conftest import likelihood_of

LOOKED_AT = ("steer_delay", "steer_lag", "mocap_latency", "speed_scale", "marker_offset",
             "tyre_friction", "rolling_drag")  # fmt: skip
SAME = {e.name: e.same_as for e in EFFECTS.values() if e.same_as}


def _library(runs, base):
    likelihood = likelihood_of(make_augmented_car(base, runs), runs)
    nuisance = nuisance_names(likelihood.predictor.augmented, runs)
    return Library(likelihood, nuisance, tuple(map(EFFECTS.get, LOOKED_AT)))


def temper_of(library, found):
    """The design effect that a case's odds are made with."""
    lowest = min((h.point for h in found.hypotheses), key=lambda point: point.cost)
    return library.design_effect(lowest.size)


@pytest.fixture(scope="module")
def explained(drive, base):
    """All hypotheses of up to two effects about drives with these effects, and their library."""

    def explained(text, seed):
        library = _library(drive(text, runs=3, seconds=6.0, seed=seed), base)
        return library, explain(library)

    return explained


late = pytest.fixture(lambda explained: explained("steer_delay=0.03", 21), scope="module")
TWO = "steer_delay=0.04,speed_scale=0.93"
both = pytest.fixture(lambda explained: explained(TWO, 8), scope="module")
fine = pytest.fixture(lambda explained: explained("", 2), scope="module")


# --- what is free
@pytest.mark.parametrize("names", [(name,) for name in SAME] + list(combinations(SAME, 2)))
def test_nothing_is_free_twice(likelihood, names):
    """A base parameter that is the same quantity as an effect is held while the effect is free."""
    library = Library(likelihood, tuple(FLOORS), ())
    free = library.space(names).chart.free
    assert len(set(free)) == len(free)
    assert not set(free) & {same for name in names for same in SAME[name]}
    assert {name.partition(".")[0] for name in free if "." in name} == set(names)
    assert set(library.space(()).chart.free) == set(FLOORS)


def test_an_effect_that_the_base_has_is_freed_once_and_one_in_place_of_all_is_looked_at(likelihood):
    library = Library(likelihood, ("lf", "steer_nonlinearity.cubic"), ())
    free = library.space(("steer_nonlinearity",)).chart.free
    assert sorted(set(free)) == sorted(free)
    assert "lf" in free
    library = Library(likelihood, ("steer_gain",), (EFFECTS["steer_gain"],))
    (look,) = screen_effects(library, begin(library, (), (), likelihood.predictor.guess))
    assert np.isfinite(look.cost)


LINEAR = [name for name in SAME if not EFFECTS[name].zero_gradient and name != "mass"]


def _moved(likelihood, effects, **by):
    """Every base parameter and some effects where their priors lie, some moved by so many sds."""
    space = Library(likelihood, tuple(FLOORS), ()).space(effects)
    z = space.centre + space.spread * [by.get(n.partition(".")[0], 0.0) for n in space.chart.free]
    return stand(likelihood, space, z, likelihood.predictor.guess, 1.0)


def test_values_are_carried_by_their_names(likelihood):
    point = _moved(likelihood, ("mocap_yaw",), lf=0.1)
    own = _moved(likelihood, ("steer_nonlinearity",), steer_nonlinearity=0.1)
    moved = carry(likelihood, own.space, point, own)
    assert (moved[0], moved[-1]) == (point.z[0], own.z[-1])
    assert carry(likelihood, own.space, point)[-1] == own.space.centre[-1]


@pytest.mark.parametrize("name", LINEAR)
def test_an_amount_is_kept_whether_the_base_or_an_effect_has_it(likelihood, name):
    """The car stays the same car, there and back."""
    base, beside = _moved(likelihood, (), **{SAME[name][0]: 0.3}), _moved(likelihood, (name,))
    moved = replace(beside, z=carry(likelihood, beside.space, base))
    assert moved.z[-1] != beside.z[-1]
    guess = likelihood.predictor.guess
    seen = [likelihood.predictor.errors(p.parameters, guess)[0] for p in (base, moved)]
    assert seen[1] == pytest.approx(seen[0], abs=1e-9)
    assert carry(likelihood, base.space, moved) == pytest.approx(base.z)


@pytest.mark.parametrize("name", ["steer_rate_limit", "accel_limit"])
def test_a_base_without_a_limit_is_as_limited(likelihood, name):
    base, beside = _moved(likelihood, ()), _moved(likelihood, (name,))
    mine = [base.space.chart.names.index(same) for same in SAME[name]]
    beside.z[-1] = 0.95 * base.parameters[mine].min()
    limited = base.space.chart.parameters(carry(likelihood, base.space, beside))
    assert limited[mine] == pytest.approx(beside.z[-1])


# --- what is looked at
def test_a_search_begins_at_the_base_and_a_start_that_that_holds_holds_no_effect_back(late):
    """The windows in which an effect shows are those that the base bends too far."""
    library, whole = late
    start = begin(library, (), (), library.likelihood.predictor.guess.copy())
    assert start.z == pytest.approx(start.space.centre)
    assert start.size == whole.start.size
    found = []
    for fill in (np.zeros_like, np.ones_like):
        rotated = start.rotated._replace(held=fill(start.rotated.held))
        found.append(screen_effects(library, replace(start, rotated=rotated)))
    assert found[0] == found[1]
    assert found[0][0].effect == "steer_delay"


# --- what comes out
@pytest.mark.parametrize("case", ["late", "both", "fine"])
def test_no_hypothesis_is_worse_than_one_nested_in_it_and_probabilities_are_a_posterior(
    case, request
):
    library, found = request.getfixturevalue(case)
    assert len(found.hypotheses) > (0 if case == "fine" else 2)
    for h, other in product(found.hypotheses, repeat=2):
        if set(other.effects) < set(h.effects):
            assert h.point.cost < other.point.cost + 0.5, (h.effects, other.effects)
    assert sum(h.probability for h in found.hypotheses) == pytest.approx(1.0)
    odds = [h.log_odds for h in found.hypotheses]
    assert odds == sorted(odds, reverse=True)
    assert len({frozenset(h.effects) for h in found.hypotheses}) == len(found.hypotheses)
    assert 2.0 <= temper_of(library, found) <= len(library.likelihood.pushed) + 1.0
    assert found.untested == ()


@pytest.mark.parametrize(("case", "hidden"), [
    ("fine", {}), ("late", {"steer_delay": (0.03, 0.003)}),
    ("both", {"steer_delay": (0.04, 0.004), "speed_scale": (0.93, 0.01)}),
])  # fmt: skip
def test_hidden_effects_are_named_and_none_is_invented(case, hidden, request):
    library, found = request.getfixturevalue(case)
    assert set(found.best.effects) == set(hidden)
    for name, (value, near) in hidden.items():
        place = library.likelihood.predictor.augmented.places(name)
        assert found.best.point.parameters[place] == pytest.approx(value, abs=near)
    assert case != "late" or found.probability("steer_delay") > 0.95
    assert case != "late" or found.start.size > c.GAP_SIZE
    assert case == "both" or found.best.point.size < c.GAP_SIZE


def test_where_an_effect_leaves_no_gap_none_clearly_behind_it_is_searched(late, monkeypatch):
    library, found = late
    monkeypatch.setattr(hypotheses, "leaves_gap", lambda point: True)
    patient = explain(library)
    assert patient.best.effects == found.best.effects
    assert len(patient.hypotheses) > len(found.hypotheses)


def test_two_causes_are_tried_where_neither_alone_outweighs_none(both, monkeypatch):
    """Two large ones: with either the other still has most windows far off."""
    library, found = both
    single = max(h.log_odds for h in found.hypotheses if len(h.effects) == 1)
    against = single + 1.0 - found.null.log_odds
    monkeypatch.setattr(c, "GAP_ODDS", c.GAP_ODDS * np.exp(-against))
    assert explain(library).hypotheses[0].effects == found.best.effects


@pytest.mark.parametrize(("case", "more"), [("late", 1.0), ("both", c.FURTHER_ODDS)])
def test_an_effect_costs_its_share_of_the_library_and_a_second_more(case, more, request):
    """Odds are the tempered evidence, less what a name costs before any data."""
    library, found = request.getfixturevalue(case)
    point = found.best.point
    price = len(found.best.effects) * np.log(len(LOOKED_AT)) + np.log(more / c.GAP_ODDS)
    [alone] = rank(library, [point])
    evidence = posterior_of(point, library.design_effect(point.size)).evidence
    assert alone.log_odds == pytest.approx(evidence - price, abs=1e-3)


def _with_loss(point, window, more):
    volume = point.at.volume + more * (np.arange(len(point.at.volume)) == window)
    return replace(point, at=point.at._replace(volume=volume))


def test_one_window_changes_no_odds_but_against_a_cause_it_counts(late):
    """A car that nearly spins multiplies any small change: one such second names no cause.

    A cause that makes one window much worse is none, whatever another does. Alike ones all count.
    """
    library, found = late
    best, null = found.best.point, found.null.point
    gains = null.at.loss - best.at.loss
    alike = replace(null, at=null.at._replace(volume=null.at.volume + 1.0 - gains))
    assert rank(library, [best, alike])[0].log_odds == rank(library, [best])[0].log_odds
    usual = _gain(library, [best, null])
    loud, bad = int(gains.argmax()), int(gains.argmin())
    assert _gain(library, [best, _with_loss(null, loud, 100.0)]) == pytest.approx(usual, abs=1e-6)
    assert _gain(library, [_with_loss(best, bad, 100.0), null]) < usual - 10.0
    other = next(h for h in found.hypotheses[1:] if len(h.effects) == 1)
    worse = [_with_loss(other.point, bad, 100.0), null]
    alone, best = _gain(library, worse, other.effects), replace(best, size=other.point.size)
    assert _gain(library, [*worse, best], other.effects) == pytest.approx(alone, abs=1e-6)


def test_knowledge_of_the_base_counts_whole_where_windows_count_in_part(late):
    """A hypothesis' optimum is that of its tempered likelihood times its prior."""
    library, found = late
    point = found.null.point
    assert library.worth > 2.0
    away = point.z - point.space.centre
    prior = 0.5 * float(away @ np.linalg.solve(point.space.covariance, away))
    assert point.space.prior_cost(point.z) == pytest.approx(library.worth * prior)
    assert replace(library, known=False).worth == 1.0
    controlled = _with_controls(library, _late_by(0.0))
    assert controlled.worth < library.worth, "without controls windows that repeat count for less"


def test_what_an_effect_gains_the_base_cannot_gain_alone(late):
    """The base alone, from where the best effect left it."""
    library, found = late
    best, null = found.best.point, found.null.point
    space = null.space
    start = stand(library.likelihood, space, carry(library.likelihood, space, best), best.x, 2.0)
    assert minimise(library.likelihood, start).cost > null.cost - 0.5


# --- healthy drives as controls
def _with_controls(library, *controls):
    """The library of a base whose healthy drives showed these."""
    predictor = library.likelihood.predictor
    space = make_space(predictor.augmented, library.nuisance)
    known = BasePrior(space.chart.free, space.covariance, controls=controls)
    predictor = replace(predictor, augmented=replace(predictor.augmented, knowledge=known))
    return replace(library, likelihood=replace(library.likelihood, predictor=predictor))


def _late_by(seconds, sd=1e-3, gain=9.0):
    return Control("steer_delay", np.array([seconds]), np.array([[sd**2]]), gain)


@pytest.fixture(scope="module")
def slightly_late(drive, base):
    """Base alone and a dead time beside it, at their optima, where steering is a little late."""
    library = _library(drive("steer_delay=0.012", runs=3, seconds=6.0, seed=21), base)
    start = begin(library, (), (), library.likelihood.predictor.guess.copy())
    null = minimise(library.likelihood, start)
    begun = begin(library, ("steer_delay",), (0.012,), null.x)
    return library, [null, minimise(library.likelihood, begun)]


def _gain(library, points, effects=("steer_delay",), beside=()):
    ranked = {h.effects: h.log_odds for h in rank(library, points)}
    return ranked[effects] - ranked[beside]


def test_what_healthy_drives_show_too_is_no_cause(slightly_late):
    library, points = slightly_late
    same, other = (_gain(_with_controls(library, _late_by(s)), points) for s in (0.012, 0.0))
    assert same < 0.0 < other


def test_what_healthy_drives_show_too_is_no_second_cause(both):
    library, found = both
    pair, single, weak = found.best.effects, ("speed_scale",), ("steer_delay",)
    by_name = {h.effects: h.point for h in found.hypotheses}
    points = [by_name[()], by_name[single], by_name[pair]]
    right = Control("speed_scale", np.ones(1), np.array([[1e-6]]), 99.0)
    known = [_with_controls(library, _late_by(s, gain=99.0), right) for s in (0.04, 0.0)]
    least, most = (_gain(each, points, pair, single) for each in known)
    assert abs(least) < 0.1 * most
    assert _gain(known[1], [*points, by_name[weak]], pair, single) == pytest.approx(most)


def test_controls_only_take_away(slightly_late):
    """Wherever healthy drives have an effect, it counts for no more than beside the base alone."""
    library, points = slightly_late
    most = _gain(_with_controls(library, _late_by(-0.5, 1e-6)), points)
    for seconds in np.linspace(-0.01, 0.01, 9):
        assert _gain(_with_controls(library, _late_by(seconds)), points) <= most + 1e-9


def test_a_clear_cause_loses_no_more_than_is_usual(late):
    """A large gap promises much along any gradient, also one of which an older file is silent."""
    library, found = late
    points = [found.null.point, found.best.point]
    other = Control("marker_offset", np.zeros(2), 1e-9 * np.eye(2), 0.2)
    shown = [(_late_by(0.002, gain=0.0),), (_late_by(0.002, gain=0.1),), (other,)]
    gains = [_gain(_with_controls(library, *each), points) for each in shown]
    most = c.SHOWN_MOST * 0.1 * len(points[0].at.dof)
    assert np.subtract(gains[0], gains[1:]) == pytest.approx([most, 2.0 * most])


def test_a_look_loses_no_more_than_its_effect_gained_in_healthy_drives(late):
    """Else what the base gains without its parameter of the same name hides the effect."""
    library, found = late
    looks = []
    for seconds in (0.0, 0.03):
        known = _with_controls(library, _late_by(seconds, gain=0.01))
        screened = screen_effects(known, found.start)
        looks += [look.gain for look in screened if look.effect == "steer_delay"]
    most = c.SHOWN_MOST * 0.01 * len(found.start.at.dof) * known.design_effect(found.start.size)
    assert looks[0] - looks[1] == pytest.approx(most)
