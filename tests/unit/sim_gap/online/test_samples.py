"""Samples: what is kept, what makes a window, what does not."""

import math

import pytest

from steerd.sim_gap.online import samples


def driven(seconds, speed=1.5, asked=1.5):
    """A straight drive at 100 Hz."""
    recent, x = samples.Recent(), 0.0
    for tick in range(round(100 * seconds)):
        t = 0.01 * tick
        x += 0.01 * speed
        recent = samples.take(recent, samples.Ordered(t, 0.1, asked))
        recent = samples.take(recent, samples.PoseSeen(t, x, 0.0, 0.0))
        recent = samples.take(recent, samples.Rolled(t, speed))
    return recent


def test_samples_are_kept_for_as_long_as_a_window_needs_them():
    recent = driven(10.0)
    for kind in (recent.poses, recent.orders, recent.wheel):
        assert kind[-1].t - kind[0].t <= samples.KEPT
        assert kind[-1].t - kind[0].t >= samples.LEAD + samples.WINDOW


@pytest.mark.parametrize("sample", [
    samples.PoseSeen(2.0, math.nan, 0.0, 0.0), samples.PoseSeen(math.inf, 0.0, 0.0, 0.0),
    samples.PoseSeen(0.5, 9.0, 9.0, 9.0), samples.Ordered(0.2, 0.3, 9.0),
    samples.Rolled(1.0, math.inf),
])  # fmt: skip
def test_what_is_no_number_or_comes_late_is_left_out(sample):
    recent = driven(1.5)
    assert samples.take(recent, sample) == recent


def test_a_window_needs_the_commands_before_it_of_which_a_pause_leaves_none():
    recent = driven(1.5)
    assert samples.first_start(recent) == pytest.approx(samples.LEAD)
    run = samples.make_window(recent, 0.7)
    assert run.pose.t[-1] - run.pose.t[0] == pytest.approx(samples.WINDOW, abs=0.011)
    assert run.pose.t[0] >= samples.LEAD - 0.011
    recent = samples.take(driven(1.5), samples.Paused(1.5))
    assert (recent, samples.first_start(recent)) == (samples.Recent(), math.inf)


@pytest.mark.parametrize(
    ("speed", "asked"), [(0.0, 1.5), (1.5, 0.0), (0.3, 0.3)], ids=["held", "rolls", "slow"]
)
def test_a_car_that_does_not_drive_makes_no_window(speed, asked):
    assert samples.make_window(driven(1.5, speed, asked), 0.7) is None
