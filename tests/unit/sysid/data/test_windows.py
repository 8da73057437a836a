"""How much of the past a window is given: all that play may remember, and no more."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerd.car_model.effects import find_effect
from steerd.car_model.ops import FLOAT
from steerd.sysid.data.windows import _remembered

LEAST, MOST = 20, 400
PLAY = find_effect("steer_backlash")


def wheel_after(steering, play, wheel):
    """The wheel's angle after these servo angles, from a wheel somewhere in the gap."""
    for angle in steering:
        wheel, _ = PLAY.linkage(FLOAT, (play,), (wheel,), angle)
    return wheel


@given(
    seed=st.integers(0, 2**32), step=st.floats(1e-4, 0.1), play=st.floats(0.0, 0.15),
    side=st.floats(-1.0, 1.0),
)  # fmt: skip
def test_nothing_before_it_changes_where_the_wheel_is(seed, step, play, side):
    steering = np.cumsum(step * np.random.default_rng(seed).normal(size=600))
    a = 599
    steps = _remembered(steering, a, LEAST, MOST)
    assert LEAST <= steps <= MOST
    if steps == MOST:
        return
    past = steering[a - steps : a + 1]
    start = steering[a - steps] + 0.5 * play * side
    assert wheel_after(past, play, start) == wheel_after(steering, play, steering[0])


def test_a_stick_that_rests_is_given_the_whole_past():
    assert _remembered(np.full(1000, 0.1), 999, LEAST, MOST) == MOST
    assert _remembered(np.full(1000, 0.1), 999, LEAST, LEAST) == LEAST, "no play is asked for"
    assert _remembered(np.full(1000, 0.1), 30, LEAST, MOST) == 80, "the drive's whole past"


@pytest.mark.parametrize(("back", "steps"), [(5, 40), (19, 40), (50, 80), (300, 320), (390, 400)])
def test_it_reaches_from_the_last_large_turn_on(back, steps):
    steering = np.zeros(1000)
    steering[: 1000 - back] = 0.3
    assert _remembered(steering, 999, LEAST, MOST) == steps
