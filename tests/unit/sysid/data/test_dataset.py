"""Bad drives are refused with a reason; good ones come out on one clock and grid."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.sysid.data import segments
from steerd.sysid.data.data_checks import DataError, noise_of
from steerd.sysid.data.dataset import HISTORY, Signal, hold_means, make_run, pose_rates
from steerd.sysid.data.excitation import speed_tracking_share
from steerd.sysid.data.windows import make_layout
from steerd.sysid.estimation.command_timing import latch


def _good(seconds=4.0):
    t = np.arange(0.0, seconds, 0.01)
    pose = np.column_stack([t, 0.1 * np.sin(t), 0.1 * np.cos(t)])
    return t, np.where(t > 1.0, 0.1, 0.0), np.ones_like(t), pose


def _make(t, steer, speed, pose, pose_t=None):
    pose_t = t if pose_t is None else pose_t
    return make_run("drive", Signal(t, steer), Signal(t, speed), Signal(pose_t, pose))


def test_a_pose_that_a_moved_clock_puts_before_the_last_is_left_out():
    t, *signals = _good()
    stalled = t.copy()
    stalled[200] = t[199] - 65e-6
    run = _make(t, *signals, stalled)
    assert len(run.pose.t) == len(t) - 1
    assert (np.diff(run.pose.t) > 0.0).all()


LATE = np.arange(400) >= 200
STUCK = np.r_[:100, [100] * 180, 280:400]
ONCE = np.arange(1200).reshape(400, 3) == 23  # the eighth yaw


@pytest.mark.parametrize(("spoil", "reason"), [
    (lambda t, a, v, p: _make(t, a, v, p, t - 0.7 * LATE), "goes back by 0.69"),
    (lambda t, a, v, p: _make(np.r_[t, t + 4.0], np.tile(a, 2), np.tile(v, 2), p, t + 1.5 * LATE),
     "stays in place"),
    (lambda t, a, v, p: _make(t, a, v, p[STUCK]), "freeze for 1.8"),
    (lambda t, a, v, p: _make(t, a, v, np.where(ONCE, np.nan, p)), "not a number"),
    (lambda t, a, v, p: _make(t, a, v, p * [1000.0, 1000.0, 1.0]), "spread over"),
    (lambda t, a, v, p: _make(t, a, v, 0.0 * p), "never moved"),
    (lambda t, a, v, p: _make(t[:50], a[:50], v[:50], p[:50]), "of driving"),
    (lambda t, a, v, p: _make(t[:1], a[:1], v[:1], p[:1]), "of driving"),
    (lambda t, a, v, p: _make(t, a * np.nan, v, p), "no steering commands"),
    (lambda t, a, v, p: _make(t, a, v, p[:0], t[:0]), "no poses"),
    (lambda t, a, v, p: _make(t * np.nan, a, v, p), "time"),
])  # fmt: skip
def test_bad_drives_are_refused(spoil, reason):
    with pytest.raises(DataError, match=reason) as caught:
        spoil(*_good())
    assert caught.value.hint


GAPS = st.lists(st.floats(0.001, 0.5), min_size=1, max_size=20)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(GAPS, st.integers(0, 1000), st.floats(0.003, 0.3))
def test_means_keep_the_area_under_a_held_signal(gaps, seed, h):
    t = np.cumsum([0.0, *gaps])
    values = np.random.default_rng(seed).normal(size=len(t))
    edges = np.arange(int(t[-1] / h) + 3) * h
    means = hold_means(Signal(t, values), edges)
    fine = np.linspace(0.0, edges[-1], 20001)
    held = values[np.clip(np.searchsorted(t, fine, side="right") - 1, 0, None)]
    assert means.sum() * h == pytest.approx(held[:-1].sum() * fine[1], abs=5e-3)
    inside = np.searchsorted(t, edges, side="right")
    for k in np.flatnonzero(inside[1:] == inside[:-1]):
        assert means[k] == pytest.approx(values[inside[k] - 1], abs=1e-9)


def test_noise_is_seen_through_motion_gaps_and_outliers():
    rng = np.random.default_rng(0)
    t = np.delete(np.arange(0.0, 20.0, 0.005), slice(1000, 1200))
    values = np.sin(2.0 * t) + 1e-3 * rng.normal(size=len(t))
    values[::97] += 0.3
    assert noise_of(t, values) == pytest.approx(1e-3, rel=0.15)
    assert noise_of(t[:5], values[:5]) == 0.0


def test_windows_share_out_every_pose_and_leave_gaps_out():
    t, steer, speed, pose = _good(8.0)
    seen = np.delete(np.arange(len(t)), slice(300, 500))
    run = _make(t, steer, speed, pose[seen], t[seen])
    layout = make_layout([run], 0.5)
    poses = np.count_nonzero(layout.seen.kind == 0)
    assert len(seen) - 8 <= poses <= len(seen)
    assert (len(layout.spans), layout.bounds[-1]) == (12, len(layout.values))
    assert np.abs(layout.guess[:, 3] - 1.0).max() < 0.05
    late = make_layout([run], 0.5, pose_delay=0.02)
    assert late.seen.t[late.seen.kind == 0].min() == pytest.approx(0.02)
    assert len(make_layout([run], np.inf).spans) == 1
    with pytest.raises(ValueError, match="grid"):
        make_layout([run, make_run("other", Signal(t, steer), None, Signal(t, pose), h=0.02)], 0.5)


def test_rows_of_a_window_are_its_own_and_know_their_time():
    t, steer, speed, pose = _good(8.0)
    told = {"wheel": Signal(t, t), "yaw_rate": Signal(t[::3], t[::3])}  # readings of a clock
    run = make_run("r", Signal(t, steer), Signal(t, speed), Signal(t, pose), **told)
    layout = make_layout([run, run], 0.5)
    assert layout.count == 32
    for w in range(layout.count):
        mine = layout.rows(w)
        values, at = layout.values[mine], layout.t[w] + layout.row_t[mine]
        channels = layout.channel[mine]
        assert set(channels) == {0, 1, 2, 3, 4}
        assert values[channels > 2] == pytest.approx(at[channels > 2])


def test_a_car_that_does_not_follow_its_speed_commands_is_noticed():
    drive = _make(*_good())
    assert speed_tracking_share([drive]) == 1.0
    slow = replace(drive, commands=drive.commands * [1.0, 3.0])
    assert speed_tracking_share([slow]) == 0.0
    assert speed_tracking_share([drive, slow]) == pytest.approx(0.5)
    assert speed_tracking_share([replace(slow, speed_source="wheel")]) == 1.0


@pytest.mark.parametrize(("blur", "source"), [(1e-4, "pose"), (2e-3, "wheel")])
def test_sharp_poses_give_a_speed_without_commands_better_than_a_wheel(blur, source):
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 8.0, 0.01)
    path = np.column_stack([t, np.sin(t), 0.2 * np.sin(t)]) + rng.normal(0.0, blur, (len(t), 3))
    spun = Signal(t, np.full(len(t), 1.4))
    run = make_run("r", Signal(t, 0.1 * np.sin(t)), None, Signal(t, path), wheel=spun)
    assert run.speed_source == source
    speed = run.commands[300:500, 1].mean()
    assert speed == pytest.approx(1.4, abs=1e-6) if source == "wheel" else speed < 1.25


# Parts of drives know where in their drive they begin: drift counts from the drive's start.
def imported(speed, rate, blur=0.0, seconds=20.0):
    """A log without speed commands of a car that goes along x, `speed` over times [s]."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    x = np.concatenate([[0.0], np.cumsum(speed(t[:-1]))]) / rate
    pose = np.column_stack([x, 0.0 * t, 0.0 * t])
    pose[:, :2] += blur * np.random.default_rng(4).normal(size=(len(t), 2))
    return make_run("log", Signal(t, 0.1 * np.sin(t)), None, Signal(t, pose))


drive = pytest.fixture(lambda: imported(lambda t: np.where(t < 4.0, 0.0, 1.0), 100.0, seconds=26.0))


def test_windows_of_blocks_and_what_is_kept_back_keep_the_time_of_the_drive(drive):
    parts = segments.moving_segments([drive])
    blocks = segments.make_blocks(parts)
    whole, yaw = make_layout(parts, 1.0).t, make_layout(blocks, 1.0).t
    assert whole[0] == pytest.approx(yaw[0])
    assert np.ptp(yaw) > 18.0
    assert np.all(np.diff(yaw) > 0.5)
    assert yaw[0] == pytest.approx(parts[0].start + HISTORY, abs=0.02)
    fitted, kept = segments.hold_out(parts, 3)
    starts = sorted(run.start for run in (*fitted, *kept))
    assert starts == sorted(run.start for run in blocks)
    poses = [{tuple(p) for b in group for p in b.pose.values} for group in (fitted, kept)]
    assert not poses[0] & poses[1]
    assert len(kept) == len(blocks) // 3


@pytest.fixture
def long_drive():
    """An hour, of which the car stands still every tenth minute."""
    t = np.arange(0.0, 3600.0, 0.02)
    speed = np.where(t % 600.0 < 60.0, 0.0, 1.0)
    turned = np.cumsum(speed) * 0.02 / 5.0
    pose = np.column_stack([5.0 * np.sin(turned), -5.0 * np.cos(turned), turned])
    return make_run("long", Signal(t, 0.1 * np.sin(t)), Signal(t, speed), Signal(t, pose))


def test_pieces_stand_for_a_long_drive(long_drive):
    pieces = segments.spread_evenly(long_drive, 600.0, 4.0)
    moving = segments.moving_segments(pieces)
    assert sum(part.driven for part in moving) == pytest.approx(600.0, rel=0.05)
    begins = [part.start for part in pieces]
    assert begins[0] < 120.0
    assert begins[-1] > 3500.0
    assert np.diff(begins).max() < 3.0 * 3600.0 * segments.PIECE / 600.0
    for piece in pieces:
        first = piece.start + piece.pose.t[0]
        x = np.interp(first, long_drive.pose.t, long_drive.pose.values[:, 0])
        assert x == pytest.approx(piece.pose.values[0, 0])
        assert piece.pose.t[0] == pytest.approx(4.0, abs=0.03)
        assert piece.history == long_drive.history
        begin = round(piece.start / piece.h)
        own = long_drive.commands[begin : begin + len(piece.commands)]
        assert np.array_equal(piece.commands, own)
        assert piece.commands.base is None, "a view keeps the whole drive in memory"
    whole, piece = (latch(replace(run, servo_frame=0.02), 0.0) for run in (long_drive, pieces[3]))
    first = round(piece.start / piece.h)
    off = piece.commands - whole.commands[first : first + len(piece.commands)]
    assert np.abs(off[5:-5]).max() < 0.003, "what led to it stays known where pulses are found"


def test_a_short_drive_stays_as_it_is_and_many_are_thinned_evenly_to_what_is_wanted(drive):
    assert segments.spread_evenly(drive, 60.0, 4.0)[0] is drive
    drives = [replace(drive, name=f"{i}") for i in range(40)]
    assert segments.thinned(drives, 40 * drive.driven) == drives
    kept = segments.thinned(drives, 10 * drive.driven)
    numbers = [int(run.name) for run in kept]
    assert (len(kept), numbers[0], numbers[-1], set(np.diff(numbers))) == (10, 0, 39, {4, 5})
    assert segments.thinned(drives, 0.0) == drives[:1]


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_reverse_is_left_out_and_its_neighbourhood_stays(rate):
    run = imported(lambda t: np.where((t > 8.0) & (t < 12.0), -1.0, 1.0), rate)
    parts = segments.moving_segments([run])
    spans = [(part.start + part.pose.t[0], part.start + part.pose.t[-1]) for part in parts]
    assert np.allclose(spans, [(HISTORY, 8.0), (12.0 + HISTORY, 20.0)], atol=0.3)
    assert segments.describe_unused([run]) == ()


@pytest.mark.parametrize("length", [segments.DURATION_MIN + 0.2, 1.6, 2.2])
def test_stretches_from_little_more_than_a_second_on_are_used(length):
    run = imported(lambda t: np.where(t % 4.0 < length, 1.0, 0.0), 50.0)
    parts = segments.moving_segments([run])
    assert len(parts) == 5
    assert min(np.ptp(part.pose.t) for part in parts) > segments.DURATION_MIN - 0.1
    assert len(make_layout(parts, 1.0).t) >= 5


def test_shorter_ones_are_counted_and_a_centimetre_of_noise_does_not_chop_a_drive():
    run = imported(lambda t: np.where((t > 10.0) & (t % 4.0 > 0.9), 0.0, 1.0), 50.0)
    (text,) = segments.describe_unused([run])
    assert "2 stretches of driving shorter than 1.2 s" in text
    run = imported(lambda t: 0.6 + 0.0 * t, 100.0, blur=0.01)
    assert np.std(pose_rates(run.pose).speed) < 0.2
    (part,) = segments.moving_segments([run])
    assert np.ptp(part.pose.t) > 18.0
