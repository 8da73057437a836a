"""Likeness of lane drives: closer is closer, laps and noise do not matter."""

import numpy as np
import pytest

from steerd.sim_gap import lane_comparison
from steerd.sim_gap.report.gap_report import lane_rows, lane_words

RATE, LENGTH, SPEED = 100.0, 12.0, 1.5


def lane(seconds=40.0, late=0.0, noise=0.0, wobble=0.0):
    """A drive whose offset follows the lane, some of it late, with a 3 Hz wobble."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * RATE)) / RATE
    s = SPEED * t % LENGTH
    angle = 2.0 * np.pi * (s - SPEED * late) / LENGTH
    e1 = 0.004 * np.sin(2.0 * angle) + noise * rng.standard_normal(len(t))
    e2 = 0.02 * np.cos(angle) + noise * rng.standard_normal(len(t))
    steer = 0.15 * np.sin(angle) + wobble * np.sin(2.0 * np.pi * 3.0 * t)
    return lane_comparison.LaneDrive(t, s, e1, e2, steer, LENGTH)


def test_a_profile_averages_laps():
    quiet, noisy = lane(), lane(seconds=160.0, noise=0.002)
    means = [lane_comparison.profile(d.s, d.length, d.e1) for d in (noisy, quiet)]
    off = means[0] - means[1]
    assert len(off) == lane_comparison.BINS
    assert np.sqrt(np.mean(off**2)) < 0.0004


def test_distance_grows_with_what_differs():
    assert lane_comparison.likeness(lane(), lane()) == (0.0, 0.0, 0.0)
    near, far = (lane_comparison.likeness(lane(), lane(late=late)) for late in (0.1, 0.4))
    assert 0.0 < near.e1 < far.e1
    assert near.e2 < far.e2
    assert lane_comparison.likeness(lane(), lane(wobble=0.02)).steer_db > 1.0


def test_the_effect_counts_where_it_brings_the_loop_closer_and_without_one_nothing_is_judged():
    lanes = lane(late=0.3, wobble=0.01), lane(), lane(late=0.28, wobble=0.01)
    good = lane_comparison.LaneComparison(*lanes, "a")
    bad = lane_comparison.LaneComparison(lane(), lane(late=0.05), lane(late=0.4, wobble=0.03), "a")
    assert [lane_comparison.encode_lane(told)["nearer"] for told in (good, bad)] == [True, False]
    assert "in no measure" in lane_words(bad)
    told = lane_comparison.LaneComparison(lane(), lane(late=0.1), None, "drive.mcap")
    assert lane_comparison.encode_lane(told)["nearer"] is None
    assert "drive.mcap" in lane_words(told)
    assert lane_comparison.encode_lane(told)["drives"]["with_effect"] is None
    assert all(row[3] == "–" for row in lane_rows(told))


def test_figures_tell_rms_mean_and_the_strongest_frequency_of_a_drive_or_its_beginning():
    told = lane_comparison.figures_of(lane(wobble=0.5))
    assert told["e1_rms"] == pytest.approx(0.004 / np.sqrt(2.0), rel=0.02)
    assert abs(told["e1_mean"]) < 1e-4
    assert told["steer_peak_hz"] == pytest.approx(3.0, abs=0.06)
    assert len(lane_comparison.as_long(lane(40.0), lane(17.0)).t) == len(lane(17.0).t)
