"""When few windows hold most of a gap, they are listed; when it is spread, nothing is said."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.sim_gap.verdict.where import FEW, MOST, Share, find_moments, moments_words, sentence_of


def words(bad, place, count=100):
    """The words about `count` windows a second apart of which `bad` have these ratios."""
    ratios = np.ones(count)
    ratios[list(bad)] = list(bad.values())
    names = ["a.mcap" if w < 50 else "b.mcap" for w in range(count)]
    return moments_words(ratios, names, np.arange(count, dtype=float), place)


def test_a_place_that_spun_the_car_twice_is_named_with_both_times():
    place = np.zeros((100, 2))
    place[[20, 70]] = [(2.0, -2.0), (3.0, -2.4)]
    assert words({20: 31.0, 70: 26.0}, place) == (
        "100% of it is in 2 of 100 windows: a.mcap at 20 s, b.mcap at 70 s, near x 2.5 m, y -2.2 m"
    )


def test_moments_at_different_places_have_no_place():
    place = np.column_stack([np.arange(100.0), np.zeros(100)])
    said = words({5: 40.0, 25: 38.0, 60: 36.0, 90: 34.0, 95: 33.0}, place)
    assert said.startswith("100% of it is in 5 of 100 windows: a.mcap at 5 s, a.mcap at 25 s, b.")
    assert "near" not in said


def test_what_is_spread_out_is_no_moment():
    assert words(dict.fromkeys(range(0, 100, 5), 9.0), np.zeros((100, 2))) == ""
    assert words({}, np.zeros((100, 2))) == ""
    assert moments_words(np.zeros(0), [], np.zeros(0), np.zeros((0, 2))) == ""


@given(st.lists(st.floats(0.0, 1e6), max_size=200))
def test_moments_are_few_and_hold_most(values):
    ratios = np.array(values)
    worst = find_moments(ratios)
    assert len(worst) <= FEW * len(ratios)
    if len(worst):
        excess = np.clip(ratios - 1.0, 0.0, 1e3)
        assert excess[worst].sum() >= MOST * excess.sum() * (1.0 - 1e-12)
        assert excess[worst].min() >= np.delete(excess, worst).max(initial=0.0)


@pytest.mark.parametrize("moments", ["", "90% of it is in 1 of 30 windows: a.mcap at 3 s"])
def test_the_sentence_ends_with_them(moments):
    text = sentence_of([Share("yaw", 0.4)], [], moments)
    assert text.endswith(f"; {moments}." if moments else "every speed, place and time.")
