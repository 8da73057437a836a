"""Drives side by side: at the same place of one lane, and over the same time."""

from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.path.path_spec import parse_path
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.sessions import compare
from steerd.daemon.sessions.compare import STEP, check_same_lane, find_shift, overlay
from steerd.daemon.sessions.info import load_recording
from steerd.sysid.report.drawing import LINES
from steerd.sysid.report.page import render_report
from steerd.sysid.report.report import Report
from tests.unit.daemon.sessions.test_plot import write_noise

CIRCLE = parse_path("circle:radius=2")


def drive(name="a.mcap", offset=0.0, lane=CIRCLE):
    along = np.linspace(0.0, 2.0 * lane.length, 5000)
    wave = 0.02 * np.sin(2.0 * np.pi * along / lane.length)
    values = {"e1": wave + offset, "e2": 0.1 * wave, "speed": 1.0 + wave, "steer_ref": wave}
    return compare.LaneSession(name, lane, None, along % lane.length, values, 2.0)


def test_places_of_different_lanes_are_not_compared():
    check_same_lane([drive(), drive("b.mcap")])
    other = drive("b.mcap", lane=parse_path("circle:radius=2.2"))
    with pytest.raises(SteerdError, match=r"b\.mcap"):
        check_same_lane([drive(), other])
    with pytest.raises(SteerdError, match="at most"):
        check_same_lane([drive()] * (len(LINES) + 1))


def test_the_page_names_the_drives_and_their_errors():
    sections = compare.compare_on_lane([drive("before.mcap", 0.03), drive("<b>.mcap", 0.001)])
    page = render_report(Report("", sections, ""))
    assert "before.mcap" in page
    assert "<b>" not in page
    assert "+30.0" in page
    assert page.count("<svg") == 5


def laps(rng, start, seconds, noise=0.02):
    """Yaw rate and speed of laps of 8 s that begin `start` seconds before the recording."""
    t = np.arange(0.0, seconds, STEP) + start
    phase = 2.0 * np.pi * t / 8.0
    ramp = np.clip(t / 2.0, 0.0, 1.0)
    clean = (ramp * (np.sin(phase) + 0.4 * np.sin(3.0 * phase)), ramp * (1.5 + 0.1 * np.cos(phase)))
    return [values + noise * rng.normal(size=t.size) for values in clean]


@pytest.mark.parametrize("hole", [0, 500])
@pytest.mark.parametrize("shift", [-1.3, 0.0, 0.05, 2.71])
def test_the_shift_is_found_to_a_step_for_laps_of_unequal_length_with_a_hole(shift, hole):
    rng = np.random.default_rng(5)
    first, second = laps(rng, -3.0, 40.0), laps(rng, -3.0 + shift, 31.0)
    first[0][900 : 900 + hole] = np.nan
    assert find_shift(first, second) == pytest.approx(shift, abs=1.01 * STEP)


def test_a_drive_is_itself_at_no_shift_and_another_at_a_given_one():
    read = load_recording(Path(__file__).parents[3] / "golden" / "slalom.mcap")
    same = overlay(read, read)
    assert same.found
    assert same.shift == 0.0
    assert all(np.nanmax(np.abs(difference)) == 0.0 for *_, difference in same.pairs.values())
    moved = overlay(read, read, 0.5)
    known, later = same.pairs["speed [m/s]"][0], moved.pairs["speed [m/s]"][1]
    np.testing.assert_allclose(later, known[: len(later)], atol=1e-9)
    assert moved.t[0] == 0.5
    with pytest.raises(SteerdError, match="no time in common"):
        overlay(read, read, 1e3)


def test_drives_without_a_lane_are_compared_over_time_alone(tmp_path, cli):
    paths = [write_noise(tmp_path / f"{name}.mcap", 2, 50) for name in "ab"]
    page = tmp_path / "ab.html"
    cli("plot", *paths, "-o", page)
    text = page.read_text(encoding="utf-8")
    assert "Not compared along a lane: a.mcap" in text
    assert "Over the same time" in text
    assert "The difference is b.mcap minus a.mcap." in text
    cli("plot", *paths, paths[0], "-o", page, code=ExitCode.INVALID)
    said = cli("plot", *paths, paths[0], "--shift", "1", code=ExitCode.USAGE).err
    assert "--shift is for two drives" in said
