"""Where the floor is suspicious: a patch is found by the errors in it, and nothing else is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.sysid.inference.places import DISCS, RADII, suspicious_discs


def drive(rng, count=120):
    """Places of windows along rounds of a track of 8 by 4 m, and what noise leaves of each."""
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    where = np.column_stack([4.0 * np.cos(phase), 2.0 * np.sin(phase)])
    return where + 0.2 * rng.normal(size=(count, 2)), rng.chisquare(12, count) / 12.0


@pytest.mark.parametrize("radius", [0.8, 1.5, 2.2])
@pytest.mark.parametrize("seed", range(5))
def test_the_first_disc_lies_on_the_patch(seed, radius):
    rng = np.random.default_rng([seed, 7])
    where, badness = drive(rng)
    centre = where[rng.integers(len(where))]
    inside = np.linalg.norm(where - centre, axis=1) < radius
    badness[inside] *= rng.uniform(3.0, 3000.0, inside.sum())
    x, y, found = suspicious_discs(where, badness)[0]
    assert np.hypot(x - centre[0], y - centre[1]) < radius
    named = np.linalg.norm(where - (x, y), axis=1) < found
    assert (named & inside).sum() > 0.6 * max(named.sum(), inside.sum())


@given(st.integers(0, 2**32), st.floats(-100.0, 100.0), st.floats(-np.pi, np.pi))
def test_it_does_not_matter_where_the_floor_has_its_origin(seed, shift, angle):
    where, badness = drive(np.random.default_rng(seed), 40)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    here = suspicious_discs(where, badness)
    there = suspicious_discs(where @ turn + shift, badness)
    assert [disc[2] for disc in here] == [disc[2] for disc in there]
    moved = np.array([disc[:2] for disc in here]).reshape(-1, 2) @ turn + shift
    assert np.allclose(moved, np.array([disc[:2] for disc in there]).reshape(-1, 2), atol=1e-9)


def test_discs_are_few_and_none_lies_in_another():
    discs = suspicious_discs(*drive(np.random.default_rng(3), 300))
    assert 1 < len(discs) <= DISCS
    for k, (x, y, radius) in enumerate(discs):
        assert radius in RADII
        for a, b, other in discs[:k]:
            assert np.hypot(x - a, y - b) > max(radius, other)


@pytest.mark.parametrize(
    ("where", "badness"),
    [
        (np.zeros((0, 2)), np.zeros(0)),
        (np.array([[1.0, 2.0]]), np.array([9.0])),
        (np.zeros((6, 2)), np.arange(6.0)),
        (np.arange(12.0).reshape(6, 2), np.ones(6)),
    ],
    ids=["no window", "one window", "the car stood", "all alike"],
)
def test_where_no_place_differs_there_is_no_disc(where, badness):
    assert suspicious_discs(where, badness) == []
