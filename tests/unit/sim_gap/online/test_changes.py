"""Ratios of the last windows, and what of them a car shows as usual."""

import numpy as np

from steerd.sim_gap.online.changes import SPANS, ratios, sharpened, unknown, with_ratios


def tables(anchor, track, looks):
    """Ratios of windows, and the same sharpened."""
    tracks = [track] * len(looks)
    table = ratios(anchor, tracks, looks)
    return table, sharpened(anchor, tracks, looks, table, np.ones_like(table))


def test_ratios_rise_only_over_windows_since_the_change(anchor, track, windows):
    looks = [*windows(8), *windows(4, seed=8, steer_bias=0.02)]
    table = ratios(anchor, [track] * 12, looks)
    bias = table[anchor.space.effects.index("steer_bias")]
    assert int(np.nanargmax(bias)) == SPANS.index(4)
    assert bias[SPANS.index(4)] > 50.0
    assert np.isnan(bias[SPANS.index(16)])


def test_quiet_windows_keep_their_ratios(anchor, track, windows):
    looks = windows(6)
    table = ratios(anchor, [track] * 6, looks)
    level = np.full_like(table, np.nanmax(table))
    assert sharpened(anchor, [track] * 6, looks, table, level) is table


def test_a_plain_change_counts_for_more_than_its_outlying_windows(anchor, track, windows):
    table, after = tables(anchor, track, windows(2, steer_bias=0.02))
    short, bias = SPANS.index(2), anchor.space.effects.index("steer_bias")
    assert after[bias, short] > 1.2 * table[bias, short]
    assert int(np.argmax(after[:, short])) == bias


def test_no_ratio_becomes_smaller_and_none_appears(anchor, track, windows):
    table, after = tables(anchor, track, windows(4, tyre_friction=-0.2))
    np.testing.assert_array_equal(np.isnan(table), np.isnan(after))
    there = np.isfinite(table)
    assert (after[there] >= table[there]).all()


def test_a_value_that_no_car_has_sharpens_nothing(anchor, track, windows):
    table, after = tables(anchor, track, windows(3, steer_bias=0.9))
    bias = anchor.space.effects.index("steer_bias")
    np.testing.assert_array_equal(table[bias], after[bias])


def test_windows_that_nothing_explains_are_no_change(anchor, track, windows):
    _, after = tables(anchor, track, windows(2, left=40.0))
    assert np.nanmax(after) < 20.0


def test_what_a_car_shows_as_usual_is_no_change():
    shape = (2, len(SPANS))
    usual = unknown(2)
    for _ in range(200):
        usual = with_ratios(usual, np.full(shape, 9.0))
    assert (usual.level() > 8.0).all()
    quiet = unknown(2)
    for _ in range(200):
        quiet = with_ratios(quiet, np.full(shape, 0.3))
    assert (quiet.level() < 2.0).all()
