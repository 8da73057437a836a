"""What is drawn of a session: curves with breaks, settled errors, the lane, what was learnt."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from steerd.daemon.imports.import_session import MessageMaker
from steerd.daemon.sessions.info import load_recording
from steerd.daemon.sessions.plot_data import GAP, LANE_HALF_WIDTH, PANELS, make_curve, make_drawing
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, Model, make_header
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.topics import MOCAP, MODEL, WHEEL, make_session_topic


def test_a_curve_is_sorted_and_broken_where_samples_are_missing_and_none_without_a_number():
    t = np.array([0.2, 0.0, 0.1, 2.0])
    (curve,) = make_curve("e1", "estimate", t, np.array([3.0, 1.0, 2.0, 4.0]))
    assert curve.t == pytest.approx([0.0, 0.1, 0.2, 0.2 + GAP / 2, 2.0])
    assert curve.value == pytest.approx([1.0, 2.0, 3.0, nan, 4.0], nan_ok=True)
    assert list(make_curve("e1", "estimate", t, np.full(4, nan))) == []


def write(path, files=None):
    maker = MessageMaker(0)
    names = {make_session_topic("car1", topic): topic.message for topic in (MOCAP, WHEEL)}
    writer = SessionWriter(path, names, {"steerd.session": {"car": "car1"}}, files or {})
    for i in range(100):
        t = i * 10_000_000
        writer.write("/steerd/car1/mocap", encode(maker.planar_pose(t, 0.02 * i, 0.0, 0.0)), t)
        writer.write("/steerd/car1/wheel", encode(maker.wheel(t, 1.9)), t)
    return load_recording(writer.finish({"reason": "imported"}))


def test_a_log_without_an_estimate_shows_the_speed_of_its_poses_beside_the_wheels(tmp_path):
    drawing = make_drawing(write(tmp_path / "a.mcap"))
    (speed,) = [panel for panel in drawing.panels if panel.title == "speed"]
    speeds = {curve.name: round(float(np.median(curve.value)), 3) for curve in speed.curves}
    assert speeds == {"wheels": 1.9, "from poses": 2.0}
    assert np.isnan(drawing.e1).all()
    assert dict(drawing.facts)["driven"] == "2.0 m"


@pytest.mark.parametrize(("text", "width"), [
    ("[safety]\nlateral = 0.2\n", 0.2), ("[safety]\n", LANE_HALF_WIDTH), ("x", LANE_HALF_WIDTH),
])  # fmt: skip
def test_the_lane_is_as_wide_as_the_watchdog_of_the_recorded_car_file_allows(tmp_path, text, width):
    car = {"car.toml": text.encode()}
    assert make_drawing(write(tmp_path / "a.mcap", car)).half_width == width


# The learner's panels of the plot page.

NS = 1_000_000_000
START = 1_700_000_000 * NS
EMPTY = Model(make_header(START, BODY), 0, -1, -1, 0, 0, nan, *(nan,) * 34, "learning", *("",) * 4)


@pytest.fixture
def session(tmp_path):
    """Ten reports: nothing at first, then a bias; from the seventh on a change at 5.5 s."""
    topic = make_session_topic("car1", MODEL)
    about = {"steerd.session": {"car": "car1"}}
    writer = SessionWriter(tmp_path / "a.mcap", {topic: Model}, about, {}, START)
    change = {"since_ns": round(105.5 * NS), "effect": "steer_bias", "verdict": "named"}
    for second in range(10):
        message = replace(
            EMPTY, header=make_header(START + second * NS, BODY), mono_ns=(100 + second) * NS,
            steer_bias=nan if second < 3 else 0.01, steer_bias_sd=1e-3,
            **(change if second >= 7 else {"verdict": "none"}),
        )  # fmt: skip
        writer.write(topic, encode(message), START + second * NS)
    return load_recording(writer.finish({"reason": "end"}))


def test_a_parameter_has_a_band_and_a_change_a_line(session):
    panels = make_drawing(session).panels
    (panel,) = [p for p in panels if p.title == "learnt: steering bias"]
    value, above, below, change = panel.curves
    np.testing.assert_allclose(value.t, np.arange(3, 10))
    np.testing.assert_allclose(value.value, np.degrees(0.01), rtol=1e-5)
    np.testing.assert_allclose(above.value - below.value, np.degrees(4e-3), rtol=1e-4)
    assert (change.name, change.t[0]) == ("change: steer_bias", pytest.approx(5.5))


def test_what_was_not_learnt_has_no_panel(session):
    titles = [panel.title for panel in make_drawing(session).panels]
    assert titles == [title for title, _, fields, _ in PANELS if "steer_bias" in fields]
