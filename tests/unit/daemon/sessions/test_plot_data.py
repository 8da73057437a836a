"""What is drawn of a session: curves with breaks, settled errors, the lane's width."""

import numpy as np
import pytest

from steerd.daemon.imports.import_session import MessageMaker
from steerd.daemon.sessions.info import load_recording
from steerd.daemon.sessions.plot_data import GAP, LANE_HALF_WIDTH, make_curve, make_drawing
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session import AttachedFile, SessionWriter
from steerd.steer_bus.topics import MOCAP, WHEEL, make_session_topic

NAN = float("nan")


def test_a_curve_is_sorted_and_broken_where_samples_are_missing():
    t = np.array([0.2, 0.0, 0.1, 2.0])
    (curve,) = make_curve("e1", "estimate", t, np.array([3.0, 1.0, 2.0, 4.0]))
    assert curve.t == pytest.approx([0.0, 0.1, 0.2, 0.2 + GAP / 2, 2.0])
    assert curve.value == pytest.approx([1.0, 2.0, 3.0, NAN, 4.0], nan_ok=True)


def test_a_curve_without_a_number_is_none():
    assert list(make_curve("e1", "estimate", np.arange(3.0), np.full(3, NAN))) == []


def write(path, *files):
    maker = MessageMaker(0)
    names = {make_session_topic("car1", topic): topic.message for topic in (MOCAP, WHEEL)}
    writer = SessionWriter(path, names, {"steerd.session": {"car": "car1"}}, list(files))
    for i in range(100):
        t = i * 10_000_000
        writer.write("/steerd/car1/mocap", encode(maker.planar_pose(t, 0.02 * i, 0.0, 0.0)), t)
        writer.write("/steerd/car1/wheel", encode(maker.wheel(t, 1.9)), t)
    return load_recording(writer.finish({"reason": "imported"}))


def test_a_log_without_an_estimate_shows_the_speed_of_its_poses_beside_the_wheels(tmp_path):
    drawing = make_drawing(write(tmp_path / "a.mcap"))
    (speed,) = [panel for panel in drawing.panels if panel.title == "speed"]
    assert {curve.name: round(float(np.median(curve.value)), 3) for curve in speed.curves} == {
        "wheels": 1.9,
        "from poses": 2.0,
    }
    assert np.isnan(drawing.e1).all()
    assert dict(drawing.facts)["driven"] == "2.0 m"


@pytest.mark.parametrize(
    ("text", "width"),
    [("[safety]\nlateral = 0.2\n", 0.2), ("[safety]\n", LANE_HALF_WIDTH), ("x", LANE_HALF_WIDTH)],
)
def test_the_lane_is_as_wide_as_the_watchdog_of_the_recorded_car_file_allows(tmp_path, text, width):
    car = AttachedFile("car.toml", "application/toml", text.encode())
    assert make_drawing(write(tmp_path / "a.mcap", car)).half_width == width
