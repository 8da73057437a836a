"""Ratios of the last windows, and what of them a car shows as usual."""

import numpy as np

from steerd.sim_gap.online.changes import SPANS, ratios, unknown, with_ratios


def test_ratios_rise_only_over_windows_since_the_change(anchor, track, windows):
    looks = [*windows(8), *windows(4, seed=8, steer_bias=0.02)]
    table = ratios(anchor, [track] * 12, looks)
    bias = table[anchor.space.effects.index("steer_bias")]
    assert int(np.nanargmax(bias)) == SPANS.index(4)
    assert bias[SPANS.index(4)] > 50.0
    assert np.isnan(bias[SPANS.index(16)])


def test_windows_that_nothing_explains_are_no_change(anchor, track, windows):
    assert np.nanmax(ratios(anchor, [track] * 2, windows(2, left=40.0))) < 20.0


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
