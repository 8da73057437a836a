"""Samples: what is kept, what makes a window, what does not."""

import math

import pytest

from steerd.sim_gap.online.samples import (
    KEPT,
    LEAD,
    WINDOW,
    Ordered,
    Paused,
    PoseSeen,
    Recent,
    Rolled,
    first_start,
    make_window,
    take,
)


def driven(seconds, speed=1.5, asked=1.5, until=math.inf):
    """A straight drive at 100 Hz, standing still from `until` on."""
    recent, x = Recent(), 0.0
    for tick in range(round(100 * seconds)):
        t = 0.01 * tick
        x += 0.01 * speed if t < until else 0.0
        recent = take(recent, Ordered(t, 0.1, asked))
        recent = take(recent, PoseSeen(t, x, 0.0, 0.0))
        recent = take(recent, Rolled(t, speed))
    return recent


def test_samples_are_kept_for_as_long_as_a_window_needs_them():
    recent = driven(10.0)
    for kind in (recent.poses, recent.orders, recent.wheel):
        assert kind[-1].t - kind[0].t <= KEPT
        assert kind[-1].t - kind[0].t >= LEAD + WINDOW


@pytest.mark.parametrize(
    "sample",
    [
        PoseSeen(2.0, math.nan, 0.0, 0.0),
        PoseSeen(math.inf, 0.0, 0.0, 0.0),
        PoseSeen(0.5, 9.0, 9.0, 9.0),
        Ordered(0.2, 0.3, 9.0),
        Rolled(1.0, math.inf),
    ],
)
def test_what_is_no_number_or_comes_late_is_left_out(sample):
    recent = driven(1.5)
    assert take(recent, sample) == recent


def test_a_window_needs_the_commands_before_it():
    recent = driven(1.5)
    assert first_start(recent) == pytest.approx(LEAD)
    run = make_window(recent, 0.7, 0.0)
    assert run.pose.t[-1] - run.pose.t[0] == pytest.approx(WINDOW, abs=0.011)
    assert run.pose.t[0] >= LEAD - 0.011


@pytest.mark.parametrize(
    ("speed", "asked"), [(0.0, 1.5), (1.5, 0.0), (0.3, 0.3)], ids=["held", "rolls", "slow"]
)
def test_a_car_that_does_not_drive_makes_no_window(speed, asked):
    assert make_window(driven(1.5, speed, asked), 0.7, 0.0) is None


def test_a_pause_ends_what_is_known_of_the_commands():
    recent = take(driven(1.5), Paused(1.5))
    assert recent == Recent()
    assert first_start(recent) == math.inf
