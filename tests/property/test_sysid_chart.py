"""Coordinates and parameters describe the same car; their derivative is what differences say."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.params import DEFAULT_CAR, PARAMETERS
from steerd.sysid.inference.chart import make_chart

NAMES = [p.name for p in PARAMETERS]
CHOICES = st.lists(st.sampled_from(NAMES), min_size=1, max_size=12, unique=True)
SETTINGS = settings(derandomize=True, deadline=None, max_examples=150)

SHARES = st.lists(st.floats(0.7, 1.4), min_size=len(NAMES), max_size=len(NAMES))
WHEELBASES = st.one_of(st.none(), st.floats(0.25, 0.5))


@SETTINGS
@given(CHOICES, SHARES, WHEELBASES)
def test_there_and_back_along_slopes_that_are_central_differences(free, shares, wheelbase):
    p = np.array(DEFAULT_CAR) * np.array(shares) + 1e-3
    chart = make_chart((), p, free, wheelbase)
    z = chart.coordinates(p)
    back = chart.parameters(z)
    follows = {"lf", "lr"} if wheelbase is not None and {"lf", "lr"} & set(free) else set()
    for name, a, b in zip(NAMES, p, back, strict=True):
        if name not in follows:
            assert abs(a - b) < 1e-9 * max(1.0, abs(a))
    if follows:
        assert abs(back[0] + back[1] - wheelbase) < 1e-12
    assert np.allclose(chart.coordinates(back), z, atol=1e-9)
    z = chart.coordinates(chart.prior)
    slopes = chart.slopes(z)
    for i in range(len(z)):
        step = np.zeros(len(z))
        step[i] = 1e-6
        central = (chart.parameters(z + step) - chart.parameters(z - step)) / 2e-6
        assert np.abs(slopes[:, i] - central).max() < 1e-5 * max(1.0, np.abs(central).max())


@SETTINGS
@given(CHOICES)
def test_bounds_hold_the_default(free):
    chart = make_chart((), np.array(DEFAULT_CAR), free)
    low, high = chart.bounds()
    z = chart.coordinates(chart.prior)
    assert np.all(low <= z + 1e-12)
    assert np.all(z <= high + 1e-12)
    assert np.all(chart.spread > 0.0)
    assert len(chart.labels) == len(z)
