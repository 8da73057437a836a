"""Scores and shares against numbers worked out by hand; no car is compiled here."""

from types import SimpleNamespace

import numpy as np
import pytest
from steerd.sim_gap.verdict.candidates import Score, gain_of, held_out
from steerd.sim_gap.verdict.decide import (
    _are_all_large,
    at_bound,
    confidence_of,
    constancy,
    doubt_of,
    indistinguishable_from,
    is_needless,
    is_significant,
    needs_both,
    se_of_lead,
)

from steerd.car_model.effects import find_effect
from steerd.sim_gap.diagnosis import is_practical, limit_verdict, share_of_most, verdict_of
from steerd.sim_gap.report.summary_text import headline, manoeuvre_words, share_words
from steerd.sim_gap.verdict.shrinkage import _shares, explained_share, floor_of, noise_margin
from steerd.sim_gap.verdict.where import Regime, Share, range_words, sentence_of
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.constants import AMBIGUOUS_MOST, PARTIAL_MOST
from steerd.sysid.inference.residuals import Gap, interval_of, robust_mean

BLOCKS = np.repeat(np.arange(4), 3)
HALF = np.arange(16) < 8


def score(name: str, losses: object, prior: float = 0.0) -> Score:
    return Score((name,), SimpleNamespace(), np.asarray(losses, float), prior)


def test_one_spun_window_counts_no_more_than_fifty_nats():
    base, other = score("base", np.zeros(12)), score("x", np.zeros(12))
    spun = np.zeros(12)
    spun[5] = 1e7
    assert gain_of(other, score("base", spun), BLOCKS)[0] == c.WINSOR
    assert gain_of(score("x", spun), base, BLOCKS)[0] == -c.WINSOR


def test_gain_counts_what_the_base_had_to_give_up():
    base, better = score("base", np.ones(12), prior=3.0), score("x", np.zeros(12), prior=1.0)
    gain, se = gain_of(better, base, BLOCKS)
    assert gain == pytest.approx(12.0 + 2.0)
    assert se == pytest.approx(0.0, abs=1e-12)


def test_standard_error_is_that_of_block_sums():
    base = np.zeros(12)
    base[:3], base[3:6] = 2.0, 1.0
    _, se = gain_of(score("x", np.zeros(12)), score("base", base), BLOCKS)
    assert se == pytest.approx(2.0 * np.std([6.0, 3.0, 0.0, 0.0], ddof=1))


@pytest.mark.parametrize(
    ("gain", "se", "expected"),
    [
        (c.GAIN_MIN - 0.1, 0.1, False),
        (30.0, 5.0, True),
        (30.0, 50.0, False),
        (400.0, 250.0, True),
        (50.0, 50.0, False),
        (150.0, 150.0, False),
        (400.0, 290.0, False),
    ],
)
def test_a_gain_is_judged_by_its_error_and_by_a_likelihoods_own(gain, se, expected):
    assert is_significant(gain, se) is expected


@pytest.mark.parametrize(("spun", "expected"), [([3], False), ([3, 4], False), ([3, 4, 9], False)])
def test_spun_windows_of_one_or_two_blocks_decide_nothing(spun, expected):
    blocks = np.repeat(np.arange(8), 3)
    lost = np.zeros(24)
    lost[spun] = 1e7
    gain, se = gain_of(score("x", np.zeros(24)), score("base", lost), blocks)
    assert gain >= c.WINSOR
    assert is_significant(gain, se) is expected


def test_a_gain_of_a_few_blocks_is_one():
    blocks = np.repeat(np.arange(8), 3)
    lost = np.zeros(24)
    lost[:9] = 40.0
    assert is_significant(*gain_of(score("x", np.zeros(24)), score("base", lost), blocks))


def test_a_near_equal_is_ambiguous_and_lowers_confidence():
    best = score("steer_lag", np.zeros(12))
    near, far = score("b", np.full(12, 0.2)), score("c", np.full(12, 20.0))
    assert indistinguishable_from(best, [best, near, far], {"d": 0.97, "e": 0.5}, BLOCKS) == (
        "b",
        "d",
    )
    alone = confidence_of(doubt_of(best, [best, far], BLOCKS))
    assert alone > 0.9
    assert confidence_of(doubt_of(best, [best, near, far], BLOCKS)) < 0.8 * alone
    assert confidence_of(doubt_of(best, [best, far], BLOCKS), broken=True) < alone
    assert confidence_of(0.0, partial=True) == PARTIAL_MOST < confidence_of(0.0) < 1.0
    assert confidence_of(5.0, partial=True) < confidence_of(5.0) < PARTIAL_MOST
    assert confidence_of(0.0, ambiguous=True) == AMBIGUOUS_MOST < PARTIAL_MOST
    assert confidence_of(50.0, ambiguous=True) == confidence_of(50.0) < AMBIGUOUS_MOST


def test_a_pair_needs_both():
    pair = score("a", np.zeros(12))
    assert is_needless(pair, score("b", np.full(12, 0.5)), BLOCKS)
    assert not is_needless(pair, score("b", np.full(12, 10.0)), BLOCKS)


@pytest.mark.parametrize(
    ("gains", "alone", "needed"),
    [
        ([2.0] * 12, 20.0, True),
        ([0.9] * 12, 20.0, False),  # too little
        ([24.0] + [0.0] * 11, 20.0, False),  # of one block
        ([2.0] * 12, 6000.0, False),  # less than how such a first cause is wrong
    ],
)
def test_a_second_cause_needs_a_gain_of_its_own(gains, alone, needed):
    pair, first = score("a+b", np.zeros(12)), score("a", gains)
    null = score("", gains, prior=alone)
    assert needs_both(pair, first, null, BLOCKS) == needed


def test_a_few_lost_windows_do_not_hide_that_all_others_are_explained():
    def fit(ratios):
        square = np.array(ratios) * 10.0
        return SimpleNamespace(at=SimpleNamespace(square=square, dof=np.full(len(ratios), 10.0)))

    before, after = fit([1.6] * 57 + [40.0] * 3), fit([1.0] * 57 + [39.0] * 3)
    assert share_of_most(before, after, 1.0) == pytest.approx(1.0)
    assert share_of_most(before, fit([1.5] * 57 + [40.0] * 3), 1.0) < 0.2


def test_what_the_base_leaves_as_it_is_matters_in_practice():
    def gap(whitened, low=0.0):
        return Gap(whitened, (low, whitened), ((1.0, 0.003, 0.0, 0.0),), ())

    choice = SimpleNamespace(gain=20.0, blocks=BLOCKS)
    after, null = gap(0.98), gap(1.0)
    assert is_practical(choice, gap(1.7, 1.4), after, null, 0.97)
    assert not is_practical(choice, gap(1.1, 1.0), after, null, 0.97)
    assert not is_practical(choice, gap(1.7, 1.4), after, null, np.inf)


@pytest.mark.parametrize(
    ("millimetres", "verdict"), [(0.33, "none"), (1.9, "none"), (2.1, "unexplained")]
)
def test_a_gap_without_a_name_matters_in_millimetres(millimetres, verdict):
    left = Gap(1.5, (1.4, 1.6), ((1.0, 1e-3 * millimetres, 0.0, 0.0),), ())
    choice = SimpleNamespace(splits=())
    assert verdict_of(choice, False, True, left, left, 0.97) == verdict
    assert verdict_of(choice, False, False, left, left, 0.97) == "none"


@pytest.mark.parametrize(
    ("second", "three", "verdict"),
    [(0.025, 0.97, "unjudged"), (0.12, 0.2, "unjudged"), (0.027, 0.18, "none")],
)
def test_a_base_that_is_far_off_is_no_base_without_a_gap(second, three, verdict):
    before = Gap(0.9, (0.8, 1.0), ((1.0, second, 0.0, 0.0), (3.0, three, 0.2, 0.0)), ())
    assert limit_verdict("none", before) == verdict
    assert limit_verdict("partial", before) == "partial"
    told = SimpleNamespace(verdict="unjudged", before=before, causes=(), next_manoeuvre=None)
    assert f"cannot be judged: the simulation is {1e3 * three:.0f} mm off after 3 s" in headline(
        told
    )
    assert "steerd identify" in manoeuvre_words(told)


def test_a_value_at_its_bound_is_told():
    effect = find_effect("yaw_inertia")
    engine = SimpleNamespace(superset=SimpleNamespace(effects=(effect,), places=lambda name: [0]))

    def at(value: float) -> tuple[str, ...]:
        fitted = SimpleNamespace(parameters=np.array([value]))
        return at_bound(engine, Score((effect.name,), fitted, np.zeros(1), 0.0))

    assert at(effect.parameters[0].high) == ("yaw_inertia",)
    assert at(1.5) == ()
    assert at(effect.parameters[0].null) == ()


def test_mass_is_never_named_alone():
    best = score("mass", np.zeros(12))
    assert indistinguishable_from(best, [best], {}, BLOCKS) == ("yaw_inertia",)


def test_robust_mean_keeps_one_and_bounds_the_rest():
    assert robust_mean(np.ones(7)) == pytest.approx(1.0)
    assert robust_mean(np.array([1.0] * 9 + [1e5])) < 6.0


def test_interval_holds_the_mean():
    values = np.random.default_rng(0).chisquare(40, 60) / 40
    draws = interval_of(values, np.repeat(np.arange(20), 3))
    assert np.percentile(draws, 5) < robust_mean(values) < np.percentile(draws, 95)


@pytest.mark.parametrize(
    ("before", "after", "share"), [(3.0, 1.0, 1.0), (3.0, 2.0, 0.5), (1.0, 1.5, 0.0), (3, 0.5, 1.0)]
)
def test_share_of_the_excess(before, after, share):
    assert explained_share(before, after, 1.0) == pytest.approx(share)


def test_noise_leaves_on_few_drives_what_the_best_fit_shows_within_two_errors():
    margin = noise_margin(np.array([-0.1, 0.1] * 50), 1.0, 4)
    assert floor_of(1.05, margin, 1.0) == 1.05
    assert floor_of(1.5, margin, 1.0) == pytest.approx(1.2)
    assert floor_of(0.5, margin, 1.0) == pytest.approx(0.8)


def test_windows_left_unexplained_are_no_noise():
    wild = np.array([-3.0, 3.0] * 50)
    assert noise_margin(wild, 1.0, 16) == pytest.approx(0.5 * c.NOISE_SPREAD)
    assert noise_margin(wild, 0.8, 64) == pytest.approx(0.2 * c.NOISE_SPREAD)


def test_no_whole_share_while_a_third_of_the_windows_stays_off():
    blocks = np.repeat(np.arange(8), 3)
    noise = np.random.default_rng(0).chisquare(40, 24) / 40
    lost = np.isin(np.arange(24) % 3, [0])
    before, after = (np.where(lost, off, share * noise) for off, share in ((2000, 3), (800, 1)))
    found = _shares(before, after, after, 1.0, blocks)
    assert found.share < 0.8
    assert found.low < found.share < found.high < 0.9


def test_a_fit_to_the_noise_leaves_a_whole_share():
    blocks = np.repeat(np.arange(8), 3)
    noise = np.random.default_rng(0).chisquare(40, 24) / 40
    found = _shares(3.0 * noise, noise, noise, 1.0, blocks)
    assert found.share > 0.97
    assert found.low > 0.9
    assert found.identifiable


def test_the_shape_of_an_effect_may_lie_at_its_bound():
    effect = find_effect("lateral_load_transfer")
    engine = SimpleNamespace(
        superset=SimpleNamespace(effects=(effect,), places=lambda name: [0, 1])
    )
    for values, told in (((1.0, 1.5), ()), ((5.0, 0.6), (effect.name,))):
        fitted = SimpleNamespace(parameters=np.array(values))
        assert at_bound(engine, Score((effect.name,), fitted, np.zeros(1), 0.0)) == told


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [(1.98, 2.02, "1.980 to 2.020 s"), (68.2, 120.4, "68 to 120 s"), (2.0, 2.0, "2.00 to 2.00 s")],
)
def test_a_range_shows_the_digits_that_tell_its_ends_apart(low, high, words):
    assert range_words(Regime("run_time", "s", low, high, 2.0, 1.5, 3.0, 0.5)) == words


def test_the_sentence_names_equation_and_regime():
    shares = [Share("steer", 0.8), Share("yaw", 0.2)]
    hard = Regime("lateral_acceleration", "m/s^2", 3.0, 5.0, 4.2, 3.0, 6.0, 0.9)
    text = sentence_of(shares, [hard])
    assert "steering actuator (80%" in text
    assert "4.2 times as large when lateral acceleration is 3.0 to 5.0 m/s²" in text
    even = Regime("speed", "m/s", 1.0, 2.0, 1.2, 0.8, 1.6, 0.3)
    assert "much the same at every speed" in sentence_of(shares, [even])


@pytest.mark.parametrize(
    ("share", "words"), [(0.0, "0%"), (0.987, "99%"), (0.9995, ">99%"), (1.0, "100%")]
)
def test_nearly_all_is_not_all(share, words):
    assert share_words(share) == words


def _line(values: np.ndarray, z: float, spread: float = 1e6) -> SimpleNamespace:
    """Windows that each read one coordinate directly, fitted at `z`; losses are nearly squares."""
    dof = np.full(len(values), 1e9)
    square = (values - z) ** 2
    at = SimpleNamespace(
        weight=np.ones(len(values)), g=(values - z)[:, None], h=np.ones((len(values), 1, 1)),
        square=square, dof=dof, finite=True,
    )  # fmt: skip
    space = SimpleNamespace(
        centre=np.zeros(1), precision=np.array([[spread**-2.0]]),
        prior_pull=lambda z: -z / spread**2,
        low=np.array([-1e9]), high=np.array([1e9]), nuisance=0, effects=("a",),
    )  # fmt: skip
    return SimpleNamespace(space=space, at=at, z=np.array([z]))


def test_a_window_is_judged_by_a_fit_that_did_not_see_it():
    values = np.array([0.0, 0.0, 0.0, 4.0])
    losses = held_out(_line(values, 1.0), np.array([0, 1, 2, 3]))
    # Without the last window the others' mean is 0; without one of the others it is 4/3.
    assert losses == pytest.approx([16.0 / 9.0] * 3 + [16.0], rel=1e-5)


def test_what_only_its_own_window_shows_gains_nothing_held_out():
    values = np.random.default_rng(1).standard_normal(24)
    fitted, folds = _line(values, float(values.mean())), np.arange(24) % 4
    losses = held_out(fitted, folds)
    expected = [
        np.square(v - values[folds != f].mean()) for v, f in zip(values, folds, strict=True)
    ]
    assert losses == pytest.approx(expected, rel=1e-4)
    assert losses.sum() > fitted.at.square.sum()


def test_the_interval_draws_blocks_not_windows():
    """Windows of a block that are alike tell no more than one of them."""
    each = np.random.default_rng(2).uniform(0.5, 1.5, 12)
    blocks = np.repeat(np.arange(12), 3)
    whole = interval_of(np.repeat(each, 3), blocks).std()
    assert whole == pytest.approx(interval_of(each, np.arange(12)).std(), rel=1e-9)
    assert whole > 1.4 * interval_of(np.repeat(each, 3), np.arange(36)).std()


def test_an_interval_of_more_than_half_tells_no_share():
    """Half of the blocks lose their gap, the others keep it: any share may be drawn."""
    blocks = np.repeat(np.arange(4), 3)
    before = np.full(12, 6.0)
    after = np.where(blocks < 2, 1.0, 6.0)
    found = _shares(before, after, np.full(12, 1.0), 1.0, blocks)
    assert found.high - found.low > 0.5
    assert not found.identifiable
    assert _shares(before, np.full(12, 1.0), np.full(12, 1.0), 1.0, blocks).identifiable


def test_a_lead_is_no_surer_than_a_likelihood_allows():
    assert se_of_lead(8.0, 1.0) == 1.0
    assert se_of_lead(8.0, 100.0) == pytest.approx(8.0)
    assert se_of_lead(-5.0, 100.0) == pytest.approx(2.0 * np.sqrt(2.0))


@pytest.mark.parametrize(("mostly", "verdict"), [(0.2, "unexplained"), (0.9, "partial")])
def test_a_gap_that_stays_in_a_few_windows_is_partly_explained(mostly, verdict):
    before, after = (Gap(w, (w - 0.1, w + 0.1), (), ()) for w in (3.0, 2.5))
    choice = SimpleNamespace(splits=())
    assert verdict_of(choice, True, True, before, after, 1.0, mostly) == verdict


@pytest.mark.parametrize(
    ("verdict", "extreme", "told"),
    [
        ("explained", ("mass",), "partial"),
        ("explained", (), "explained"),
        ("none", ("mass",), "none"),
    ],
)
def test_an_effect_at_its_bound_explains_a_part_at_most(verdict, extreme, told):
    near = Gap(1.0, (0.9, 1.1), ((1.0, 0.01, 0.0, 0.0),), ())
    assert limit_verdict(verdict, near, extreme) == told


def test_halves_that_disagree_break_an_effect(monkeypatch):
    monkeypatch.setattr(
        "steerd.sim_gap.verdict.decide.parts_of", lambda engine, fitted: {"half": HALF}
    )
    engine = SimpleNamespace(superset=SimpleNamespace(nulls={"a": (0.0,)}))
    apart = _line(np.where(HALF, 0.0, 10.0), 5.0)
    (split,) = constancy(engine, apart)
    assert (split.first, split.second) == (pytest.approx(0.0, abs=1e-6), pytest.approx(10.0))
    assert split.sigmas == pytest.approx(10.0 / np.hypot(1.0 / np.sqrt(8.0), 1.0 / np.sqrt(8.0)))
    assert split.broken
    (same,) = constancy(engine, _line(np.full(16, 5.0), 5.0))
    assert not same.broken


def test_every_effect_of_a_hypothesis_must_be_large():
    engine = SimpleNamespace(
        superset=SimpleNamespace(
            nulls={"steer_delay": (0.0,), "mass": (1.0,)},
            places=lambda name: {"steer_delay": np.array([0]), "mass": np.array([1])}[name],
        )
    )
    for values, told in (((0.03, 1.5), True), ((0.03, 1.01), False), ((0.0005, 1.5), False)):
        fitted = SimpleNamespace(parameters=np.array(values))
        pair = Score(("steer_delay", "mass"), fitted, np.zeros(1), 0.0)
        assert _are_all_large(engine, pair) is told


def test_draws_of_lost_windows_do_not_lift_the_floor():
    """Half of the blocks are lost before and after: drawn often, they must not pass for noise."""
    blocks = np.repeat(np.arange(8), 3)
    noise = np.random.default_rng(0).chisquare(40, 24) / 40
    before, after = (np.where(blocks < 4, off, k * noise) for off, k in ((2000, 3), (800, 1)))
    found = _shares(before, after, after, 1.0, blocks)
    assert found.low < found.share < found.high < found.low + 0.2
