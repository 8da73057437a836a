"""Which design steers: how one comes into force, and all that brings the file's back.

Proposals at the desk: taken piece by piece, refused with a reason, left alone when hostile.
"""

from dataclasses import replace
from itertools import pairwise

import pytest

from steerd.car_model.state import State
from steerd.controller.lane_controller import start_controller
from steerd.controller.learnt import Learnt
from steerd.controller.live import AS_DESIGNED
from steerd.daemon.loop import adapting as a
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from tests.designs import design_for, scaled, standard

MS = 1_000_000
AT = State(0.02, 0.01, 0.03, 1.4, 0.2, 0.0, 0.05)
OFF_LANE = AT._replace(y=AT.y + 0.4)
NOW, TICK = 50_000_000_000, 10_000_000
DESIGN = {"steer_gain": 0.9, "steer_bias": 0.02, "steer_delay": 0.05}

held = pytest.fixture(lambda: standard(), scope="module")
design = pytest.fixture(lambda held: design_for(held, **DESIGN), scope="module")


@pytest.fixture(scope="module")
def body(held):
    return design_for(held, body_yaw=0.03, body_forward=0.02)


def drive(now, ticks, memory=None, start=0, seen=AT, live=AS_DESIGNED, driving=True, renew=()):
    """Tick by tick about one place; the orders, and where it ended."""
    memory = memory or start_controller(now.controller, seen, start)
    orders, issued = [], None
    for k in range(1, ticks + 1):
        t = start + k * 10 * MS
        if k in renew:
            now = replace(now, heard_ns=t)
        command, report, memory, now = a.steer(
            now, memory, seen, t, issued=issued, driving=driving, stop=False, live=live
        )
        issued = command
        now = a.remember_order(now, t, command)
        orders.append(command.steer)
    return orders, report, memory, now


def following(held, design, ticks=30):
    now = a.take_design(a.make_adapting(held.file, held, 0.5), 1, design, "", 0)
    return drive(now, ticks)


def test_without_the_option_nothing_is_followed(held, design):
    off = a.make_adapting(held.file)
    assert a.take_design(off, 1, design, "", 0) is off
    orders, _, _, end = drive(off, 5)
    assert end is off
    plain = a.make_adapting(held.file, held)
    assert drive(plain, 5)[0] == orders, "and until one is taken every order is the same"
    desk = a.DesignDesk()
    desk.offer(off, encode(a.make_design(NOW, 0, 1, design)), NOW)
    assert all(desk.step(off, NOW, 0) is None for _ in range(100)), "nor looked at"


def test_a_design_comes_into_force_in_the_next_tick(held, design):
    _, _, memory, now = following(held, design, 1)
    assert now.follows
    assert (now.number, now.car, now.why) == (1, design.car, "")
    assert now.controller.table == design.table
    assert len(memory.past) == design.table.pasts != held.file.table.pasts


def test_no_change_of_designs_moves_a_wheel_and_the_difference_fades(held, design):
    base = a.make_adapting(held.file, held, 0.5)
    orders, _, memory, now = drive(base, 40)
    now = a.take_design(now, 1, design, "", 400 * MS)
    after, _, memory, now = drive(now, 300, memory, 400 * MS)
    assert abs(after[0] - orders[-1]) < 0.003
    assert max(abs(y - x) for x, y in pairwise(after)) < 0.003
    assert abs(after[-1] - orders[-1]) > 0.01, "a gain and a bias later the order is another"
    assert abs(now.offset) < 0.002
    now = a.take_design(now, 0, None, "doubt", 3400 * MS)
    back, _, _, now = drive(now, 1, memory, 3400 * MS)
    assert not now.follows
    assert abs(back[0] - after[-1]) < 0.003


def test_a_silent_learner_is_not_followed(held, design):
    silent = a.SILENT_NS // (10 * MS)
    *_, now = following(held, design, silent + 2)
    assert (now.follows, now.why) == (False, a.SILENT)
    renewed = a.take_design(a.make_adapting(held.file, held, 0.5), 1, design, "", 0)
    *_, now = drive(renewed, silent + 2, renew=(300,))
    assert now.follows


@pytest.mark.parametrize(("change", "why"), [
    ({"driving": False}, a.DRIVE_ENDED), ({"live": AS_DESIGNED._replace(gain=1.2)}, a.TUNED),
    ({"seen": OFF_LANE}, a.FAR),
])  # fmt: skip
def test_what_brings_the_files_design_back(held, design, change, why):
    _, _, memory, now = following(held, design)
    *_, now = drive(now, 2, memory, 300 * MS, **change)
    assert (now.follows, now.why, now.coming) == (False, why, None)


def test_a_car_far_off_its_lane_is_not_trusted_to_the_learner_again_in_this_drive(held, design):
    _, _, memory, now = following(held, design)
    _, _, memory, now = drive(now, 2, memory, 300 * MS, seen=OFF_LANE)
    now = a.take_design(now, 2, design, "", 320 * MS)
    _, _, memory, now = drive(now, 2, memory, 320 * MS)
    assert (now.follows, now.why) == (False, a.FAR)
    _, _, memory, now = drive(now, 1, memory, 340 * MS, driving=False)
    now = a.take_design(now, 3, design, "", 350 * MS)
    *_, now = drive(now, 2, memory, 350 * MS)
    assert now.follows


def test_without_an_estimate_it_is_the_files_at_once(held, design):
    *_, now = following(held, design)
    lost = a.lose_estimate(now)
    assert (lost.follows, lost.offset, lost.why) == (False, 0.0, a.LOST)


def test_lane_errors_are_those_of_the_poses_whatever_the_learner_says_of_the_body(held, body):
    plain = drive(a.make_adapting(held.file, held, 0.5), 1)[1]
    _, report, _, now = following(held, body, 1)
    assert now.follows
    assert (report.e1, report.e2) == pytest.approx((plain.e1, plain.e2), abs=1e-12)


def test_the_body_is_turned_and_moved_back_for_the_lane_keeper(held, body):
    *_, now = following(held, body, 1)
    seen = a.see_as_learnt(now, AT)
    assert seen.yaw == pytest.approx(AT.yaw - 0.03)
    assert seen.x == pytest.approx(AT.x - 0.02, abs=1e-4)
    assert seen.yaw + seen.slip_angle == pytest.approx(AT.yaw + AT.slip_angle), "the same course"


def test_the_wheels_are_where_the_learnt_servo_is(held, design):
    *_, now = following(held, design, 200)
    order = now.servo.orders[-1][1]
    assert a.see_as_learnt(now, AT).steer == pytest.approx(0.9 * order + 0.02, abs=5e-3)


def test_past_references_fit_the_design(held, design):
    memory = start_controller(held.file, AT, 0)._replace(past=(0.1,))
    assert a.hand_over(memory, 3).past == (0.1, 0.1, 0.1)
    assert a.hand_over(memory._replace(past=(0.1, 0.2)), 1).past == (0.1,)
    assert a.hand_over(memory._replace(past=()), 2).past == (0.0, 0.0)


# Proposals at the desk, which checks them piece by piece.


near = pytest.fixture(lambda held: design_for(held, steer_gain=0.98), scope="module")


class Bench:
    """A desk, and the loop's part of it."""

    def __init__(self, held):
        self.desk, self.now, self.t = a.DesignDesk(), a.make_adapting(held.file, held), NOW

    def offer(self, design, number=1):
        self.desk.offer(self.now, encode(a.make_design(self.t, 0, number, design)), self.t)

    def step(self, driving=True):
        """A tick: the loop's part, then the desk's."""
        self.t += TICK
        self.now = a.step_adapting(self.now, self.t, driving=driving, tuned=False)
        taken = self.desk.step(self.now, self.t, 0)
        if taken is not None:
            self.now = a.take_design(
                self.now, taken.number, a.read_design(taken), taken.text, self.t
            )
        return taken

    def until_taken(self, most=200):
        for ticks in range(1, most):
            taken = self.step()
            if taken is not None:
                return ticks, taken
        raise AssertionError("nothing was taken")


@pytest.fixture
def followed(held, near):
    """A bench whose loop follows the near design."""
    bench = Bench(held)
    bench.offer(near)
    bench.until_taken()
    bench.step()
    return bench


def test_a_good_design_is_taken_after_some_ticks_and_the_same_again_is_no_second_check(held, near):
    bench = Bench(held)
    bench.offer(near)
    ticks, taken = bench.until_taken()
    assert ticks > 20, "no tick has the time for the whole check"
    assert (taken.number, a.read_design(taken)) == (1, near)
    bench.step()
    assert bench.now.follows
    bench.offer(near)
    ticks, taken = bench.until_taken()
    assert (ticks, taken.number) == (1, 1)


def test_a_bad_one_is_refused_with_the_reason_and_the_files_comes_back(followed, held):
    followed.offer(scaled(design_for(held, steer_gain=0.97), -1.0))
    _, taken = followed.until_taken()
    assert taken.number == 0
    assert taken.text.startswith(a.REFUSED)
    followed.step()
    assert (followed.now.follows, followed.desk.refused) == (False, 1)


def test_what_comes_during_a_check_is_left_alone(held, near):
    bench = Bench(held)
    bench.offer(near)
    bench.step()
    for _ in range(50):
        bench.offer(scaled(near, -1.0))
    assert a.read_design(bench.until_taken()[1]) == near
    assert bench.desk.refused == 0


@pytest.mark.parametrize(
    "wrong", [-a.OLD_NS - 1, a.OLD_NS + 1, b"", b"\0" * 40, b"\xff" * 5000, b"\0" * 200_000]
)
def test_what_is_out_of_time_or_no_design_is_left_alone(held, near, wrong):
    bench, in_time = Bench(held), isinstance(wrong, bytes)
    data = wrong if in_time else encode(a.make_design(NOW + wrong, 0, 1, near))
    bench.desk.offer(bench.now, data, NOW)
    assert all(bench.step() is None for _ in range(100))
    assert bench.desk.refused == 0


def test_no_proposal_brings_the_files_design_back(followed):
    said = encode(a.make_no_design(followed.t, 0, "a change is being looked into"))
    followed.desk.offer(followed.now, said, followed.t)
    taken = followed.step()
    assert (taken.number, taken.text) == (0, "a change is being looked into")
    followed.step()
    assert not followed.now.follows


def test_the_loops_own_way_back_is_said_once(followed):
    taken = followed.step(driving=False)
    assert (taken.number, taken.text) == (0, "no drive")
    assert followed.step(driving=False) is None


def test_a_check_against_what_is_no_longer_in_force_counts_for_nothing(followed, held):
    followed.offer(design_for(held, steer_gain=0.955))
    followed.step()
    followed.step(driving=False)
    assert all(followed.step() is None for _ in range(100))
    assert not followed.now.follows


@pytest.mark.parametrize(("columns", "gains"), [
    (0, b""), (10, b""), (10, b"\0" * 79), (8, b"\0" * 64), (121, b"\0" * 968),
    (10, b"\0" * 80 * 401),
])  # fmt: skip
def test_what_is_no_table_is_refused(columns, gains):
    car = Learnt(*(0.0,) * len(Learnt._fields))
    message = m.Design(m.make_header(0, m.BODY), 0, 1, columns, *car, 0.1, 0.25, "", gains)
    with pytest.raises(ValueError, match="no rows"):
        a.read_design(message)
