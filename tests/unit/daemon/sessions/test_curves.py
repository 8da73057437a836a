"""Curves on a page: no peak is lost, no break is bridged, what was packed comes out again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.sessions.curves import BREAK, HELD, VALUE, Grid, decimate, make_grid, pack
from tests.unit.daemon.sessions.page_script import unpack

NUMBERS = st.floats(-1e6, 1e6)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.lists(NUMBERS, min_size=1, max_size=300, unique=True), st.integers(1, 40))
def test_every_pair_of_slots_keeps_its_extremes_in_their_order(values, buckets):
    t = np.linspace(0.0, 10.0, len(values))
    value = np.array(values)
    grid = make_grid(0.0, 10.0, buckets)
    out, kinds = decimate(grid, t, value)
    where = np.minimum((t / (2 * grid.step)).astype(int), grid.slots // 2 - 1)
    for bucket in range(grid.slots // 2):
        inside = value[where == bucket]
        pair = slice(2 * bucket, 2 * bucket + 2)
        shown = out[pair][kinds[pair] == VALUE]
        assert shown.size == min(len(inside), 2) or np.ptp(inside) == 0.0
        if len(inside):
            assert {shown.min(), shown.max()} == {inside.min(), inside.max()}
            rising = np.argmax(inside) > np.argmin(inside)
            assert shown.size == 1 or np.ptp(inside) == 0 or (shown[1] > shown[0]) == rising


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    st.lists(st.tuples(NUMBERS, st.sampled_from([HELD, VALUE, BREAK])), min_size=2, max_size=200)
)
def test_packing_keeps_values_to_one_level(items):
    items = items[: len(items) // 2 * 2]
    out = np.array([v for v, _ in items])
    kinds = np.array([k for _, k in items], np.uint8)
    values, again = unpack(pack(out, kinds), len(items))
    assert again.tolist() == kinds.tolist()
    known = kinds == VALUE
    assert np.isnan(values[~known]).all()
    step = np.ptp(out[known]) / 65535 if known.any() else 0.0
    assert np.abs(values[known] - out[known]).max(initial=0.0) <= 0.51 * step + 1e-9


def test_a_break_lasts_until_the_next_value():
    grid = make_grid(0.0, 1.0, 100, 0.01)
    t = np.arange(10) * 0.1 + 0.001
    value = np.array([1.0, 2.0, np.nan, np.nan, 3.0, 4.0, 4.0, 4.0, 4.0, np.nan])
    _, kinds = decimate(grid, t, value)
    assert set(kinds[40:80]) == {BREAK}
    assert set(kinds[20:40]) == {VALUE, HELD}
    assert set(kinds[180:]) == {BREAK}


@pytest.mark.parametrize(("step", "slots"), [(0.0, 4), (1.0, 3), (1.0, 0), (float("nan"), 4)])
def test_a_grid_that_cannot_be(step, slots):
    with pytest.raises(ValueError, match="grid"):
        Grid(0.0, step, slots)
