"""What is nearly a change is fitted with weights at the fit, and nothing else is touched."""

import numpy as np
import pytest

from steerd.sim_gap.online import sharpening
from steerd.sim_gap.online.changes import SPANS, ratios, suspects
from steerd.sim_gap.online.sharpening import sharpened

EFFECTS = ("steer_bias", "steer_gain", "marker_offset", "tyre_friction")


@pytest.fixture
def tables(anchor, track):
    """Ratios of windows, and the same sharpened."""

    def make(looks):
        tracks = [track] * len(looks)
        table = ratios(suspects(anchor, EFFECTS, tracks, looks), len(EFFECTS))
        level = np.ones_like(table)
        return table, sharpened(anchor, EFFECTS, tracks, looks, table, level)

    return make


def test_quiet_windows_keep_their_ratios(tables, windows, monkeypatch):
    monkeypatch.setattr(sharpening, "WORTH", 1e9)
    table, after = tables(windows(6))
    assert after is table


def test_a_plain_change_counts_for_more_than_its_outlying_windows(tables, windows):
    table, after = tables(windows(2, steer_bias=0.02))
    short = SPANS.index(2)
    assert after[0, short] > 1.2 * table[0, short]
    assert int(np.argmax(after[:, short])) == 0


def test_no_ratio_becomes_smaller_and_none_appears(tables, windows):
    table, after = tables(windows(4, tyre_friction=-0.2))
    np.testing.assert_array_equal(np.isnan(table), np.isnan(after))
    there = np.isfinite(table)
    assert (after[there] >= table[there]).all()


def test_windows_that_nothing_explains_are_still_no_change(tables, windows):
    _, after = tables(windows(2, left=40.0))
    assert np.nanmax(after) < 20.0
