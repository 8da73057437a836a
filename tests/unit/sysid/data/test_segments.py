"""Parts of drives know where in their drive they begin: drift counts from the drive's start."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sysid.data import segments
from steerd.sysid.data.dataset import HISTORY, Signal, make_run, pose_speed
from steerd.sysid.data.windows import make_layout


@pytest.fixture
def drive():
    t = np.arange(0.0, 26.0, 0.01)
    speed = np.where(t < 4.0, 0.0, 1.0)
    x = np.cumsum(speed) * 0.01
    pose = np.column_stack([x, 0.01 * np.sin(t), 0.0 * t])
    return make_run("drive", Signal(t, 0.1 * np.sin(t)), Signal(t, speed), Signal(t, pose))


def test_windows_of_blocks_keep_the_time_of_the_drive(drive):
    parts = segments.moving_segments([drive])
    whole, yaw = make_layout(parts, 1.0).t, make_layout(segments.make_blocks(parts), 1.0).t
    assert whole[0] == pytest.approx(yaw[0])
    assert np.ptp(yaw) > 18.0
    assert np.all(np.diff(yaw) > 0.5)
    assert yaw[0] == pytest.approx(parts[0].start + HISTORY, abs=0.02)


def test_what_is_kept_back_keeps_its_time(drive):
    fitted, kept = segments.hold_out(segments.moving_segments([drive]), 3)
    starts = sorted(run.start for run in (*fitted, *kept))
    blocks = segments.make_blocks(segments.moving_segments([drive]))
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
        assert np.interp(first, *(long_drive.pose.t, long_drive.pose.values[:, 0])) == (
            pytest.approx(piece.pose.values[0, 0])
        )
        assert piece.pose.t[0] == pytest.approx(4.0, abs=0.03)
        assert piece.history == long_drive.history
        assert piece.commands.base is None, "a view keeps the whole drive in memory"


def test_a_short_drive_stays_as_it_is(drive):
    assert segments.spread_evenly(drive, 60.0, 4.0)[0] is drive


def test_drives_are_thinned_evenly_to_what_is_wanted(drive):
    drives = [replace(drive, name=f"{i}") for i in range(40)]
    assert segments.thinned(drives, 40 * drive.driven) == drives
    kept = segments.thinned(drives, 10 * drive.driven)
    numbers = [int(run.name) for run in kept]
    assert len(kept) == 10
    assert (numbers[0], numbers[-1]) == (0, 39)
    assert set(np.diff(numbers)) == {4, 5}
    assert segments.thinned(drives, 0.0) == drives[:1]


def imported(speed, rate, blur=0.0):
    """A log without speed commands of a car that goes along x, `speed` over times [s]."""
    t = np.arange(0.0, 20.0, 1.0 / rate)
    noise = blur * np.random.default_rng(4).normal(size=(len(t), 2))
    x = np.concatenate([[0.0], np.cumsum(speed(t[:-1]))]) / rate
    pose = np.column_stack([x, 0.0 * t, 0.0 * t])
    pose[:, :2] += noise
    return make_run("log", Signal(t, 0.1 * np.sin(t)), None, Signal(t, pose))


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
    lengths = [part.pose.t[-1] - part.pose.t[0] for part in parts]
    assert min(lengths) > segments.DURATION_MIN - 0.1
    assert len(make_layout(parts, 1.0).t) >= 5


def test_shorter_ones_are_counted():
    run = imported(lambda t: np.where((t > 10.0) & (t % 4.0 > 0.9), 0.0, 1.0), 50.0)
    (text,) = segments.describe_unused([run])
    assert "2 stretches of driving shorter than 1.2 s" in text


def test_a_centimetre_of_noise_does_not_chop_a_drive():
    run = imported(lambda t: 0.6 + 0.0 * t, 100.0, blur=0.01)
    assert np.std(pose_speed(run.pose).values) < 0.2
    (part,) = segments.moving_segments([run])
    assert part.pose.t[-1] - part.pose.t[0] > 18.0
