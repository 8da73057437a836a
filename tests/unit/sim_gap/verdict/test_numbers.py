"""Scores, shares and moments against numbers worked out by hand; no car is compiled here."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.sim_gap.diagnosis import grown_leads, is_far
from steerd.sim_gap.report.gap_report import furthest, headline, manoeuvre_words, share_words
from steerd.sim_gap.verdict import where
from steerd.sim_gap.verdict.confidence import Estimated
from steerd.sim_gap.verdict.residual_shape import _rank_correlation
from steerd.sim_gap.verdict.shrinkage import _shares, explained_share, noise_level
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.likelihood import Reduced
from steerd.sysid.inference.residuals import Error, Gap, Lead, held_out, interval_of, robust_mean


def _gap(*errors: tuple[float, float]) -> Gap:
    """A gap with errors [m, rad, m/s] after so many seconds."""
    return Gap(0.9, (0.8, 1.0), tuple(Lead(t, *[Error(e, e, e)] * 3) for t, e in errors))


def test_position_errors_that_grow_are_told_by_their_lead_and_too_large_ones_with_what_to_do():
    before = _gap((0.1, 0.002), (1.0, 0.020), (3.0, 0.1))
    assert grown_leads(before, before) == ()
    assert grown_leads(before, _gap((0.1, 0.004), (1.0, 0.010), (3.0, 0.15))) == (3.0,)
    assert grown_leads(before, _gap((0.1, 0.005), (1.0, 0.025), (3.0, 0.05))) == (0.1, 1.0)
    before = _gap((1.0, 0.025), (3.0, 0.97))
    assert is_far(before)
    assert not is_far(Gap(0.9, (0.8, 1.0), (Lead(3.0, *[Error(0.97, 0.04, 1.2)] * 3),)))
    told = SimpleNamespace(verdict="unjudged", before=before, causes=(), next_manoeuvre=None)
    assert "cannot be judged: the simulation is 970 mm off after 3 s" in headline(told)
    assert "steerd identify" in manoeuvre_words(told)


def test_how_large_an_effect_is_its_place_does_not_say():
    values = {"x": (-18.0, 0.1), "y": (9.0, 0.1), "radius": (2.0, 0.1), "drop": (0.4, 0.06)}
    at = {name: Estimated(*each, "m") for name, each in values.items()}
    assert furthest(SimpleNamespace(effect="grip_patch", parameters=at)) == ("drop", at["drop"])


def test_robust_mean_keeps_one_and_bounds_the_rest():
    assert robust_mean(np.ones(7)) == pytest.approx(1.0)
    assert robust_mean(np.array([1.0] * 9 + [1e5])) < 6.0


@pytest.mark.parametrize(
    ("before", "after", "share"), [(3.0, 1.0, 1.0), (3.0, 2.0, 0.5), (1.0, 1.5, 0.0), (3, 0.5, 1.0)]
)
def test_share_of_the_excess(before, after, share):
    assert explained_share(before, after, 1.0) == pytest.approx(share)


@pytest.mark.parametrize(("best", "level"), [(1.05, 1.05), (1.5, 1.2), (0.5, 0.8)])
def test_noise_leaves_on_few_drives_what_the_best_fit_shows_within_two_errors(best, level):
    found = noise_level(best, np.array([-0.1, 0.1] * 50), 1.0, 4)
    assert found == pytest.approx((level, 0.2))


@pytest.mark.parametrize(("floor", "blocks", "share"), [(1.0, 16, 0.5), (0.8, 64, 0.2)])
def test_windows_left_unexplained_are_no_noise(floor, blocks, share):
    margin = noise_level(1.0, np.array([-3.0, 3.0] * 50), floor, blocks)[1]
    assert margin == pytest.approx(share * c.NOISE_SPREAD)


BLOCKS, NOISE = np.repeat(np.arange(8), 3), np.random.default_rng(0).chisquare(40, 24) / 40


@pytest.mark.parametrize("lost", [np.arange(24) % 3 == 0, BLOCKS < 4], ids=["a third", "half"])
def test_no_whole_share_while_many_windows_stay_off(lost):
    """Drawn often, what is lost before and after must not pass for noise."""
    before, after = (np.where(lost, off, share * NOISE) for off, share in ((2000, 3), (800, 1)))
    found = _shares(before, after, after, 1.0, BLOCKS)
    assert found.share < 0.8
    assert found.low < found.share < found.high < min(0.9, found.low + 0.2)


def test_a_fit_to_the_noise_leaves_a_whole_share():
    found = _shares(3.0 * NOISE, NOISE, NOISE, 1.0, BLOCKS)
    assert found.share > 0.97
    assert found.low > 0.9
    assert found.identifiable


@pytest.mark.parametrize(("low", "high", "unit", "words"), [
    (1.98, 2.02, "s", "1.980 to 2.020 s"), (-0.03, 1.2, "m", "0.0 to 1.2 m"),
    (2.49, 2.490001, "m/s", "2.49 m/s"), (-np.pi / 2, 0.75, "rad", "-90 to 43°"),
])  # fmt: skip
def test_a_range_shows_the_digits_that_tell_its_ends_apart(low, high, unit, words):
    assert where.range_words(where.Regime("run_time", low, high, 2.0, 0.5, 1.5, 3.0, unit)) == words


def test_speeds_that_are_the_same_but_for_rounding_go_with_nothing():
    time, rounding = np.arange(40.0), 1e-16 * np.arange(40)
    for speed in (1.3 + rounding, np.where(time == 20, 1.0, 1.5) + rounding):
        assert abs(_rank_correlation(speed, time)) < 0.1
    assert _rank_correlation(-time, np.exp(time)) == pytest.approx(-1.0)


def test_the_sentence_names_equation_and_regime():
    shares = [where.Share("steer", 0.8), where.Share("yaw", 0.2)]
    hard = where.Regime("lateral_acceleration", 3.0, 5.0, 4.2, 0.9, 3.0, 6.0, "m/s^2")
    text = where.sentence_of(shares, [hard])
    assert "steering actuator (80%" in text
    assert "4.2 times as large when lateral acceleration is 3.0 to 5.0 m/s²" in text
    even = where.Regime("speed", 1.0, 2.0, 1.2, 0.3, 0.8, 1.6, "m/s")
    assert "much the same at every speed" in where.sentence_of(shares, [even])
    moments = "90% of it is in 1 of 30 windows: a.mcap at 3 s"
    assert where.sentence_of(shares, [hard], moments).endswith(f"would remove); {moments}.")


@pytest.mark.parametrize(
    ("share", "words"), [(0.0, "0%"), (0.987, "99%"), (0.9995, ">99%"), (1.0, "100%")]
)
def test_nearly_all_is_not_all(share, words):
    assert share_words(share) == words


DOF = 1e9


def _line(values: np.ndarray, z: float) -> SimpleNamespace:
    """Windows that each read one coordinate directly, fitted at `z`; losses are nearly squares."""
    count, off = len(values), values - z
    at = Reduced(
        here=off**2, square=off**2, dof=np.full(count, DOF), volume=np.zeros(count),
        g=off[:, None], h=np.ones((count, 1, 1)), dx=np.zeros((count, 7)),
        kx=np.zeros((count, 7, 1)),
    )  # fmt: skip
    space = SimpleNamespace(
        centre=np.zeros(1), precision=np.array([[1e-12]]), prior_pull=lambda z: -1e-12 * z,
        low=np.array([-1e9]), high=np.array([1e9]), nuisance=0, effects=("a",),
    )  # fmt: skip
    return SimpleNamespace(space=space, at=at, z=np.array([z]))


def test_what_only_its_own_window_shows_gains_nothing_held_out():
    values = np.random.default_rng(1).standard_normal(24)
    fitted, folds = _line(values, float(values.mean())), np.arange(24) % 4
    losses = DOF * held_out(fitted, folds)
    means = [values[folds != fold].mean() for fold in folds]
    assert losses == pytest.approx(np.square(values - means), rel=1e-4)
    assert losses.sum() > fitted.at.square.sum()


def test_the_interval_draws_blocks_not_windows():
    """Windows of a block that are alike tell no more than one of them."""
    each = np.random.default_rng(2).uniform(0.5, 1.5, 12)
    draws = interval_of(np.repeat(each, 3), np.repeat(np.arange(12), 3))
    assert np.percentile(draws, 5) < robust_mean(each) < np.percentile(draws, 95)
    whole = draws.std()
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


# When few windows hold most of a gap, they are listed; when it is spread, nothing is said.
def words(bad, place):
    """The words about 100 windows a second apart of which `bad` have these ratios."""
    ratios = np.array([bad.get(w, 1.0) for w in range(100)])
    names = ["a.mcap"] * 50 + ["b.mcap"] * 50
    return where.moments_words(ratios, names, np.arange(100.0), place)


def test_moments_are_named_with_their_times_and_a_place_that_they_share():
    place = np.zeros((100, 2))
    place[[20, 70]] = [(2.0, -2.0), (3.0, -2.4)]
    told = "in 2 of 100 windows: a.mcap at 20 s, b.mcap at 70 s, near x 2.5 m, y -2.2 m"
    assert words({20: 31.0, 70: 26.0}, place) == f"100% of it is {told}"
    place = np.column_stack([np.arange(100.0), np.zeros(100)])
    said = words({5: 40.0, 25: 38.0, 60: 36.0, 90: 34.0, 95: 33.0}, place)
    assert said.startswith("100% of it is in 5 of 100 windows: a.mcap at 5 s, a.mcap at 25 s, b.")
    assert "near" not in said
    assert words(dict.fromkeys(range(0, 100, 5), 9.0), np.zeros((100, 2))) == ""
    assert words({}, np.zeros((100, 2))) == ""
    assert where.moments_words(np.zeros(0), [], np.zeros(0), np.zeros((0, 2))) == ""


@given(st.lists(st.floats(0.0, 1e6), max_size=200))
def test_moments_are_few_and_hold_most(values):
    ratios = np.array(values)
    worst = where.find_moments(ratios)
    assert len(worst) <= where.FEW * len(ratios)
    if len(worst):
        excess = np.clip(ratios - 1.0, 0.0, 1e3)
        assert excess[worst].sum() >= where.MOST * excess.sum() * (1.0 - 1e-12)
        assert excess[worst].min() >= np.delete(excess, worst).max(initial=0.0)
