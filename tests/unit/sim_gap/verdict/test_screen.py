"""An effect that cannot be simulated is said to be untested, and takes no other with it."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.verdict.candidates import rank_singles, refit, singles
from steerd.sim_gap.verdict.screen import STRAYED, screen
from steerd.sysid.inference.base_fit import null_fit, open_engine
from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.knowledge import Knowledge
from steerd.sysid.inference.levenberg_marquardt import minimise
from steerd.sysid.inference.space import nuisance_names
from steerd.sysid.inference.superset import make_superset

NAMES = ("steer_bias", "steer_gain", "scrub", "speed_scale")


@pytest.fixture(scope="module")
def case(drive, base):
    runs = drive("steer_bias=0.02", runs=2, seconds=6.0, seed=11)
    superset = make_superset(base, runs)
    nuisance = nuisance_names(superset, runs)
    engine = open_engine(superset, runs)
    return engine, null_fit(engine, nuisance), nuisance


def test_all_are_tested_where_all_stay_finite(case):
    promises = screen(*case, NAMES)
    assert {p.effect for p in promises} == set(NAMES)
    assert all(p.tested for p in promises)
    assert promises[0].effect == "steer_bias"


def test_one_that_diverges_is_untested_and_the_others_promise_as_before(case, monkeypatch):
    engine, null, nuisance = case
    whole = {p.effect: p.gain for p in screen(engine, null, nuisance, NAMES)}
    linear = Engine.linear

    def diverging(self, space, z, x):
        found = linear(self, space, z, x)
        return found._replace(finite=found.finite and "scrub" not in space.effects)

    monkeypatch.setattr(Engine, "linear", diverging)
    promises = {p.effect: p for p in screen(engine, null, nuisance, NAMES)}
    assert not promises["scrub"].tested
    assert promises["scrub"].gain == -np.inf
    for name in set(NAMES) - {"scrub"}:
        assert promises[name].tested
        assert promises[name].gain == pytest.approx(whole[name], rel=1e-6)


def test_a_window_whose_derivatives_are_lost_stops_no_scan(case):
    """A window on the edge of a spin: its curvature is the difference of two huge numbers."""
    engine, null, nuisance = case
    names = (*NAMES, "steer_backlash")
    whole = {p.effect: p.gain for p in screen(engine, null, nuisance, names)}
    spoilt, worst = null.tangent.h.copy(), int(np.argmax(null.at.square / null.at.dof))
    spoilt[worst, 0, 0] = -1e12
    edge = replace(null, tangent=null.tangent._replace(h=spoilt))
    found = {p.effect: p for p in screen(engine, edge, nuisance, names)}
    assert found["steer_backlash"].gain == 0.0
    for name in NAMES:
        assert found[name].gain == pytest.approx(whole[name], rel=1e-6)

    ratios = np.sort(null.at.square / null.at.dof)
    lost = replace(edge, at=null.at._replace(limit=float(ratios[-2:].mean())))
    gains = [p.gain for p in screen(engine, lost, nuisance, names)]
    assert np.isfinite(gains).all()
    assert max(gains) > 0.5 * max(whole.values())


def test_an_effect_that_the_base_stands_in_for_is_seen(drive, base):
    """`accel_max` and `decel_max`, far from what is known of them, do the same as the limit."""
    runs = drive("accel_limit=1.0", runs=2, seconds=6.0, seed=11)
    nuisance = ("accel_max", "decel_max")
    known = Knowledge(nuisance, np.diag([0.15**2, 0.2**2]), values=(5.0, 5.0))
    superset = replace(make_superset(base, runs), knowledge=known)
    engine = open_engine(superset, runs)
    null = null_fit(engine, nuisance)
    strayed = null.space.base_cost(null.z)
    assert strayed > 5.0 * STRAYED
    (promise,) = screen(engine, null, nuisance, ["accel_limit"])
    assert promise.gain > 0.5 * strayed
    found = refit(engine, null, nuisance, [promise])
    assert found.fitted.own == pytest.approx([1.0], rel=0.05)
    assert found.prior < 0.1 * strayed
    assert found.fitted.cost < null.cost - 0.7 * strayed


def test_the_reader_is_told(case):
    from steerd.sim_gap import diagnosis

    engine, _, _ = case
    bare = diagnosis._Case(engine.superset, engine, (), diagnosis.Options(), (), 1.0)
    choice = type("Choice", (), {"splits": ()})()
    notes = diagnosis._notes(replace(bare, untested=("scrub",)), True, choice, ())
    assert any("could not be tested" in note and "scrub" in note for note in notes)
    assert not any("could not" in note for note in diagnosis._notes(bare, True, choice, ()))


def _unfinished(engine, null):
    """The base where a search might have come to rest too early: off its optimum."""
    space = null.space
    z = np.clip(null.z + 2.0 * space.spread, space.low, space.high)
    return minimise(engine, space, z, null.x.copy(), steps=0)


def test_what_the_base_alone_gains_is_no_effects(drive, base):
    """Effects that have nothing in common gain alike on a base that is not at its best."""
    runs = drive("", runs=2, seconds=6.0, seed=12)
    superset = make_superset(base, runs)
    nuisance = nuisance_names(superset, runs)
    engine = open_engine(superset, runs)
    null = null_fit(engine, nuisance)
    early = _unfinished(engine, null)
    assert early.cost > null.cost + 50.0
    names = ("scrub", "steer_gain")
    by_chance = singles(engine, early, nuisance, names)
    assert len(by_chance) == 2
    assert all(score.fitted.cost < early.cost - 50.0 for score in by_chance), "both explain it"
    better, ranked = rank_singles(engine, early, nuisance, names, 1, 10)
    assert better.cost == pytest.approx(null.cost, abs=2.0)
    assert all(score.fitted.cost > better.cost - 5.0 for score in ranked)


def test_an_effect_that_is_there_keeps_its_gain(case):
    engine, null, nuisance = case
    kept, (best, *_) = rank_singles(engine, null, nuisance, NAMES, 1, 10)
    assert kept is null, "without the effect the base goes back to where it was"
    assert best.effects == ("steer_bias",)
    assert best.fitted.cost < null.cost - 50.0
