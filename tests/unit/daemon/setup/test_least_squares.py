"""Least squares, jackknife and delay search against cases with known answers."""

import numpy as np
import pytest

from steerd.daemon.setup.least_squares import (
    BLOCKS,
    find_delay,
    find_slip_warnings,
    jackknife_sd,
    make_jackknife_masks,
    solve_least_squares,
)


def test_an_exact_line_is_solved_without_residual():
    x = np.linspace(0.0, 1.0, 20)
    solution, left = solve_least_squares(np.column_stack([x, np.ones(20)]), 3.0 * x - 2.0)
    assert solution == pytest.approx([3.0, -2.0])
    assert left == pytest.approx(np.zeros(20), abs=1e-12)


def test_each_good_sample_is_left_out_once():
    good = np.arange(50) % 3 > 0
    masks = make_jackknife_masks(good)
    assert len(masks) == BLOCKS
    left_out = np.array([good & ~mask for mask in masks])
    assert np.array_equal(left_out.sum(axis=0), good.astype(int))
    assert not any(np.any(mask & ~good) for mask in masks)


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(3).normal(size=200)
    masks = make_jackknife_masks(np.ones(200, dtype=bool))
    (sd,) = jackknife_sd([np.array([values[mask].mean()]) for mask in masks])
    blocks = values.reshape(BLOCKS, -1).mean(axis=1)
    assert sd == pytest.approx(blocks.std(ddof=1) / np.sqrt(BLOCKS), rel=1e-9)


def test_a_delay_between_grid_points_is_found_among_several_minima():
    def cost(tau):
        return (tau - 0.1234) ** 2 + 1e-3 * np.sin(60.0 * (tau - 0.1234)) ** 2

    assert find_delay(cost) == pytest.approx(0.1234, abs=1e-4)


def test_hard_cornering_is_warned_of():
    assert find_slip_warnings(np.full(100, 1.9)) == []
    (warning,) = find_slip_warnings(np.full(100, -2.1))
    assert "drive slower" in warning
