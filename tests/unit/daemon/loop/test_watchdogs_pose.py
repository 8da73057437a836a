"""Frame watchdogs: what counts as a bad frame, frozen, jump; and 5 % loss that must not trip."""

from math import inf, nan, nextafter, pi

import pytest

from steerd.daemon.loop import watchdogs_pose as wp
from steerd.daemon.loop.watchdogs_pose import PoseWatch, is_flapping
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.watching import seen

TH = Thresholds(
    jump_speed=2.0, jump_margin=0.0625, yaw_step=0.5, quaternion_tolerance=0.015625,
    freeze_speed=0.125,
)  # fmt: skip
ACCEPTED, INVALID, FROZEN, JUMP, REBASED = wp.PoseVerdict
S = 10**9


def frame(t_s=1.0, number=1, x=1.0, y=2.0, yaw=0.0, **changes):
    place, t_ns = changes.pop("place", (x, y, 0.125)), changes.pop("t_ns", round(t_s * S))
    return seen(t_ns, place, yaw, number=number, **changes)


BASE = PoseWatch(frame())


def judge(next_frame, watch=BASE, wheel=0.0, may_rebase=False):
    return wp.step_pose(TH, watch, next_frame, wheel, may_rebase)


@pytest.mark.parametrize("changes", [
    {}, *({"turn": q} for q in [(1.015625, 0, 0, 0), (0, 0.984375, 0, 0), (0.5,) * 4]),
    *({"place": place} for place in [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]),
])  # fmt: skip
def test_first_sane_frame_is_a_start(changes):
    watch, verdict = judge(frame(**changes), PoseWatch())
    assert (watch.base, verdict) == (frame(**changes), REBASED)
    assert judge(frame(tracking_valid=False, **changes), PoseWatch())[1] == INVALID


@pytest.mark.parametrize("bad", [
    {"tracking_valid": False}, {"live": False}, {"place": (0.0, 0.0, 0.0)},
    {"place": (nan, 1.0, 1.0)}, {"place": (1.0, inf, 1.0)}, {"place": (inf, -inf, 1.0)},
    {"yaw": nan}, {"turn": (0.0, 0.0, 0.0, 0.0)}, {"turn": (nan, 0.0, 0.0, 1.0)},
    {"turn": (nextafter(1.015625, inf), 0.0, 0.0, 0.0)},
    {"turn": (0.0, 0.0, nextafter(0.984375, 0.0), 0.0)},
    {"number": 1}, {"number": 0}, {"t_ns": S}, {"t_ns": S - 1},
])  # fmt: skip
def test_bad_frames_are_counted_and_dropped(bad):
    watch = BASE
    for count in range(1, 7):
        watch, verdict = judge(frame(**{"t_s": 1.01, "number": 2} | bad), watch)
        assert (verdict, watch.invalid, watch.base) == (INVALID, count, frame())
    watch, verdict = judge(frame(1.05, 9), watch)
    assert (verdict, watch.invalid) == (ACCEPTED, 0)


def test_sources_without_frame_numbers_rise_by_time():
    watch = PoseWatch(frame(number=-1))
    assert judge(frame(1.01, -1, x=1.01), watch)[1] == ACCEPTED
    assert judge(frame(1.0, -1, x=1.01), watch)[1] == ACCEPTED, "one stamp, in their order"
    assert judge(frame(0.999, -1, x=1.01), watch)[1] == INVALID


def test_the_poses_of_one_segment_share_its_stamp_and_the_time_before_it():
    """2 m/s, 0.1 s without a pose: 0.2 m and the margin are theirs together."""
    watch = PoseWatch(frame(1.0, -1, x=1.0))
    for x in (1.05, 1.1, 1.15, 1.2, 1.2625):
        watch, verdict = judge(frame(1.1, -1, x=x), watch, wheel=1.0)
        assert (verdict, watch.invalid, watch.jumps) == (ACCEPTED, 0, 0)
    assert judge(frame(1.1, -1, x=nextafter(1.2625, inf)), watch)[1] == JUMP
    assert judge(frame(1.1, -1, x=1.2, yaw=0.6), watch)[1] == JUMP, "yaw is bounded by frame"
    watch, verdict = judge(frame(1.11, -1, x=1.3), watch)
    assert verdict == ACCEPTED, "the next segment counts from the newest pose"
    assert judge(frame(1.11, -1, x=1.35), watch)[1] == JUMP, "and with its own time alone"


@pytest.mark.parametrize(
    ("rejected", "verdict"), [(TH.nis_frames - 1, ACCEPTED), (TH.nis_frames, REBASED)]
)
def test_a_filter_that_went_astray_begins_again_while_nothing_moves(rejected, verdict):
    astray = changed(BASE, rejected=rejected, rejections=(1 << rejected) - 1)
    after = frame(1.01, 2)
    assert judge(after, astray)[1] == ACCEPTED
    watch, found = judge(after, astray, may_rebase=True)
    assert found == verdict
    assert (watch == PoseWatch(after)) is (verdict == REBASED)


def test_freeze_needs_identical_bits_and_turning_wheels():
    same = frame(1.01, 2)
    assert judge(same, wheel=0.125)[1] == ACCEPTED
    for wheel in (nextafter(0.125, 1), -1.0):
        watch, verdict = judge(same, wheel=wheel)
        assert (verdict, watch.frozen, watch.base) == (FROZEN, 1, frame())
    barely = nextafter(1.0, 2)
    for moved in ({"x": barely}, {"turn": (barely, 0.0, 0.0, 0.0)}):
        assert judge(frame(1.01, 2, **moved), wheel=1.0)[1] == ACCEPTED
    watch, _ = judge(frame(1.02, 3), judge(same, wheel=1.0)[0], wheel=1.0)
    assert watch.frozen == 2
    assert judge(frame(1.03, 4, x=1.01), watch, wheel=1.0)[0].frozen == 0


REACH = 2.0 * 0.25 + 0.0625  # in a quarter of a second [m]


@pytest.mark.parametrize(("base", "next_frame", "verdict"), [
    *((frame(), frame(1.25, 2, **at), verdict) for at, verdict in (
        ({"x": 1.0 + REACH}, ACCEPTED), ({"y": 2.0 - REACH}, ACCEPTED),
        ({"x": nextafter(1.0 + REACH, 9)}, JUMP), ({"y": 2.0 + REACH + 1e-9}, JUMP))),
    *((frame(), frame(1.01, 2, yaw=yaw), verdict) for yaw, verdict in (
        (0.5, ACCEPTED), (-0.5, ACCEPTED), (nextafter(0.5, 1), JUMP), (nextafter(-0.5, -1), JUMP))),
    (frame(yaw=pi - 0.1), frame(1.01, 2, yaw=-pi + 0.1), ACCEPTED),
    (frame(number=-1), frame(1.0, -1, x=1.0625), ACCEPTED),  # a first pose: no time before it
    (frame(number=-1), frame(1.0, -1, x=1.0626), JUMP),
])  # fmt: skip
def test_jumps_by_distance_and_yaw_at_their_edges(base, next_frame, verdict):
    watch, found = judge(next_frame, PoseWatch(base))
    assert found == verdict
    jumped = (1, base, (next_frame.t_arrival_ns,)) if verdict == JUMP else (0, next_frame, ())
    assert (watch.jumps, watch.base, watch.jump_times) == jumped


def test_an_accepted_frame_ends_the_row_but_not_the_memory_of_jumps():
    watch, _ = judge(frame(1.01, 2, x=9.0))
    watch, verdict = judge(frame(1.02, 3), watch)
    assert (verdict, watch.jumps, len(watch.jump_times)) == (ACCEPTED, 0, 1)


def test_alternating_yaw_is_flapping_after_five():
    watch = BASE
    for k in range(10):
        flip = pi if k % 2 else 0.0
        watch, _ = judge(frame(1.01 + k / 100, 2 + k, yaw=flip), watch, wheel=0.0)
        assert is_flapping(TH, watch, watch.base.t_arrival_ns) == (k == 9)
    assert watch.jumps <= 1
    first = watch.jump_times[0]
    assert is_flapping(TH, watch, first + S)
    assert not is_flapping(TH, watch, first + S + 1)


def test_only_the_last_five_jumps_are_kept():
    watch = BASE
    for k in range(9):
        watch, _ = judge(frame(1.0 + k, 2 + k, x=99.0), watch)
    assert watch.jump_times == tuple(round((1.0 + k) * S) for k in range(4, 9))
    assert not is_flapping(TH, watch, 9 * S)


def test_carried_by_hand_becomes_the_new_truth_only_while_nothing_may_move():
    watch = BASE
    for k in range(2):
        watch, verdict = judge(frame(1.01 + k / 100, 2 + k, x=99.0), watch, may_rebase=True)
        assert verdict == JUMP
    last = frame(1.05, 9, x=99.0)
    assert judge(last, watch, may_rebase=False)[1] == JUMP
    watch, verdict = judge(last, watch, may_rebase=True)
    assert (watch, verdict) == (PoseWatch(last), REBASED)


def test_restarted_server_becomes_the_new_truth_but_garbage_never_does():
    watch = PoseWatch(frame(number=10_000))
    for k in range(4):
        watch, verdict = judge(frame(1.01 + k / 100, k), watch, may_rebase=True)
        assert verdict == INVALID
    assert judge(frame(1.05, 5), watch, may_rebase=False)[1] == INVALID
    assert judge(frame(1.05, 5), watch, may_rebase=True)[1] == REBASED
    assert judge(frame(1.05, 5, tracking_valid=False), watch, may_rebase=True)[1] == INVALID


def test_innovations_in_a_row_and_their_share():
    watch = BASE
    for count, rejected, *then in ((4, True, 4, 0.08), (1, False, 0, 0.08), (45, False, 0, 0.08),
                                   (1, False, 0, 0.06)):  # fmt: skip
        for _ in range(count):
            watch = wp.step_innovation(TH, watch, rejected)
        assert [watch.rejected, wp.rejected_share(TH, watch)] == then


def test_frames_and_innovations_leave_each_other_alone():
    busy = PoseWatch(frame(), frame(0.99, 0), 1, 2, 3, (4,), 1, 0b101)
    assert wp.step_innovation(TH, busy, True) == changed(busy, rejected=2, rejections=0b1011)
    after, _ = judge(frame(1.01, 2), busy)
    assert (after.rejected, after.rejections) == (1, 0b101)
