"""Proposals at the desk: taken piece by piece, refused with a reason, left alone when hostile."""

import pytest

from steerd.controller.learnt import Learnt
from steerd.daemon.loop.adapting import (
    OLD_NS,
    REFUSED,
    DesignDesk,
    make_adapting,
    make_design,
    make_no_design,
    read_design,
    step_adapting,
    take_design,
)
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from tests.designs import design_for, scaled, standard

NOW = 50_000_000_000
TICK = 10_000_000


@pytest.fixture(scope="module")
def held():
    return standard()


@pytest.fixture(scope="module")
def near(held):
    return design_for(held, steer_gain=0.98)


class Bench:
    """A desk, and the loop's part of it."""

    def __init__(self, held):
        self.desk, self.now, self.t = DesignDesk(), make_adapting(held.file, held), NOW

    def offer(self, design, number=1):
        self.desk.offer(self.now, encode(make_design(self.t, 0, number, design)), self.t)

    def step(self, driving=True):
        """A tick: the loop's part, then the desk's."""
        self.t += TICK
        self.now = step_adapting(self.now, self.t, driving=driving, tuned=False)
        taken = self.desk.step(self.now, self.t, 0)
        if taken is not None:
            self.now = take_design(self.now, taken.number, read_design(taken), taken.text, self.t)
        return taken

    def until_taken(self, most=200):
        for ticks in range(1, most):
            taken = self.step()
            if taken is not None:
                return ticks, taken
        raise AssertionError("nothing was taken")


@pytest.fixture
def following(held, near):
    """A bench whose loop follows the near design."""
    bench = Bench(held)
    bench.offer(near)
    bench.until_taken()
    bench.step()
    return bench


def test_a_good_design_is_taken_after_some_ticks(held, near):
    bench = Bench(held)
    bench.offer(near)
    ticks, taken = bench.until_taken()
    assert ticks > 20, "no tick has the time for the whole check"
    assert (taken.number, read_design(taken)) == (1, near)
    bench.step()
    assert bench.now.follows


def test_the_same_again_is_no_second_check(following, near):
    following.offer(near)
    ticks, taken = following.until_taken()
    assert (ticks, taken.number) == (1, 1)


def test_a_bad_one_is_refused_with_the_reason_and_the_files_comes_back(following, held):
    following.offer(scaled(design_for(held, steer_gain=0.97), -1.0))
    _, taken = following.until_taken()
    assert taken.number == 0
    assert taken.text.startswith(REFUSED)
    following.step()
    assert (following.now.follows, following.desk.refused) == (False, 1)


def test_what_comes_during_a_check_is_left_alone(held, near):
    bench = Bench(held)
    bench.offer(near)
    bench.step()
    for _ in range(50):
        bench.offer(scaled(near, -1.0))
    assert read_design(bench.until_taken()[1]) == near
    assert bench.desk.refused == 0


@pytest.mark.parametrize("off", [-OLD_NS - 1, OLD_NS + 1])
def test_what_is_out_of_time_is_left_alone(held, near, off):
    bench = Bench(held)
    bench.desk.offer(bench.now, encode(make_design(NOW + off, 0, 1, near)), NOW)
    assert all(bench.step() is None for _ in range(100))


@pytest.mark.parametrize("data", [b"", b"\0" * 40, b"\xff" * 5000, b"\0" * 200_000])
def test_bytes_that_are_no_design_are_left_alone(held, data):
    bench = Bench(held)
    bench.desk.offer(bench.now, data, NOW)
    assert bench.step() is None
    assert bench.desk.refused == 0


def test_no_proposal_brings_the_files_design_back(following):
    said = encode(make_no_design(following.t, 0, "a change is being looked into"))
    following.desk.offer(following.now, said, following.t)
    taken = following.step()
    assert (taken.number, taken.text) == (0, "a change is being looked into")
    following.step()
    assert not following.now.follows


def test_the_loops_own_way_back_is_said_once(following):
    taken = following.step(driving=False)
    assert (taken.number, taken.text) == (0, "no drive")
    assert following.step(driving=False) is None


def test_a_check_against_what_is_no_longer_in_force_counts_for_nothing(following, held):
    following.offer(design_for(held, steer_gain=0.955))
    following.step()
    following.step(driving=False)
    assert all(following.step() is None for _ in range(100))
    assert not following.now.follows


def test_without_the_option_nothing_is_looked_at(held, near):
    desk, off = DesignDesk(), make_adapting(held.file)
    desk.offer(off, encode(make_design(NOW, 0, 1, near)), NOW)
    assert all(desk.step(off, NOW, 0) is None for _ in range(100))


# A design as a message: the same bits back, and what is no design.


@pytest.mark.parametrize(
    ("columns", "gains"),
    [(0, b""), (10, b""), (10, b"\0" * 79), (8, b"\0" * 64), (121, b"\0" * 968),
     (10, b"\0" * 80 * 401)],
)  # fmt: skip
def test_what_is_no_table_is_refused(columns, gains):
    car = Learnt(*(0.0,) * len(Learnt._fields))
    message = m.Design(m.make_header(0, m.BODY), 0, 1, columns, *car, 0.1, 0.25, "", gains)
    with pytest.raises(ValueError, match="no rows"):
        read_design(message)
