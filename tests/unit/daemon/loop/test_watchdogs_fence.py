"""The fence: inside and outside, and the stopping distance before it (W19)."""

from dataclasses import replace
from math import cos, nan, pi

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import is_inside
from tests.unit.daemon.loop.watching import HARD, TH, WARN, brief, down, look, up

SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
ELL = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0))


def test_inside_a_polygon():
    assert is_inside(SQUARE, 0.0, 0.0)
    assert is_inside(SQUARE, down(2.0), 0.0)
    assert not is_inside(SQUARE, 2.0, 0.0)
    assert not is_inside(SQUARE, up(2.0), 0.0)
    assert is_inside(ELL, 1.0, 3.0)
    assert is_inside(ELL, 3.0, 1.0)
    assert not is_inside(ELL, 3.0, 3.0)
    assert not is_inside(SQUARE, nan, 0.0)
    assert not is_inside(SQUARE, 0.0, nan)
    for turned in (SQUARE[::-1], SQUARE[2:] + SQUARE[:2]):
        assert is_inside(turned, 1.9, -1.9)
        assert not is_inside(turned, 1.9, -2.1)


def test_fence_counts_the_stopping_distance():
    th = replace(TH, fence=SQUARE)
    reach = 0.25 + 0.5 + 0.125  # v 2: 2*0.125 + 4/8 + margin
    for course, sign in ((0.0, 1.0), (pi, -1.0)):
        for speed in (2.0, -2.0):
            edge = 2.0 - reach
            changes = {"course": course, "speed": speed}
            assert brief(look(th, x=sign * (edge - 0.51), **changes)) == []
            assert brief(look(th, x=sign * (edge - 0.49), **changes)) == [("W19", WARN)]
            assert brief(look(th, x=sign * (edge - 0.001), **changes)) == [("W19", WARN)]
            assert brief(look(th, x=sign * (edge + 0.001), **changes)) == [("W19", HARD)]
    assert brief(look(th, y=2.0 - reach + 0.001, course=pi / 2, speed=2.0)) == [("W19", HARD)]
    assert brief(look(th, x=nan)) == [("W19", HARD)]
    (unknown,) = look(th, x=nan)
    assert unknown.text == "W19 fence: where the car is is not known"
    assert brief(look(th, x=1.0, speed=0.0, state=SupervisorState.DISARMED)) == []
    assert cos(0.0) == 1.0
    parked = look(th, x=2.0 - 0.125, speed=0.0, state=SupervisorState.DISARMED)
    assert brief(parked) == [("W19", HARD)]


def test_slanted_fences_and_diagonal_travel():
    kite = ((0.0, -2.0), (3.0, 1.0), (0.0, 2.0), (-1.0, 1.0))
    assert is_inside(kite, 1.0, 0.0)
    assert not is_inside(kite, 2.0, -0.5)
    assert is_inside(kite, 1.9, 0.0)
    assert not is_inside(kite, 2.1, 0.0)
    assert is_inside(kite, -0.3, 0.0)
    assert not is_inside(kite, -0.7, 0.0)
    th = replace(TH, fence=SQUARE)
    for course, x, y in ((0.6, 1.0, 0.0), (0.6 + pi, -1.0, 0.0), (0.9, 0.0, 1.0)):
        out = look(th, x=x, y=y, course=course, speed=2.0)  # needs 0.875 m: stays just inside
        assert brief(out) == [("W19", WARN)]
        out = look(th, x=1.5 * x, y=1.5 * y, course=course, speed=2.0)
        assert brief(out) == [("W19", HARD)]
    assert look(th, x=-1.0, course=0.6, speed=2.0) == ()
