"""The learner's panels of the plot page."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from steerd.daemon.sessions.info import load_recording
from steerd.daemon.sessions.plot_data import make_drawing
from steerd.daemon.sessions.plot_model import PANELS, with_model
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, Model, make_header
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.topics import MODEL, make_session_topic

NS = 1_000_000_000
START = 1_700_000_000 * NS
EMPTY = Model(make_header(START, BODY), 0, -1, -1, 0, 0, nan, *(nan,) * 34, "learning", *("",) * 4)


def report(second, bias=nan, since=-1, effect=""):
    return replace(
        EMPTY, header=make_header(START + second * NS, BODY), mono_ns=(100 + second) * NS,
        steer_bias=bias, steer_bias_sd=1e-3, since_ns=since, effect=effect,
        verdict="named" if effect else "none",
    )  # fmt: skip


@pytest.fixture
def session(tmp_path):
    """Ten reports: nothing at first, then a bias; from the seventh on a change at 5.5 s."""
    topic = make_session_topic("car1", MODEL)
    writer = SessionWriter(
        tmp_path / "a.mcap", {topic: Model}, {"steerd.session": {"car": "car1"}}, (), START
    )
    for second in range(10):
        late = second >= 7
        message = report(
            second, nan if second < 3 else 0.01, round(105.5 * NS) if late else -1,
            "steer_bias" if late else "",
        )  # fmt: skip
        writer.write(topic, encode(message), START + second * NS)
    return load_recording(writer.finish({"reason": "end"}))


def test_a_parameter_has_a_band_and_a_change_a_line(session):
    panels = with_model(make_drawing(session), session).panels
    (panel,) = [p for p in panels if p.title == "learnt: steering bias"]
    value, above, below, change = panel.curves
    np.testing.assert_allclose(value.t, np.arange(3, 10))
    np.testing.assert_allclose(value.value, np.degrees(0.01), rtol=1e-5)
    np.testing.assert_allclose(above.value - below.value, np.degrees(4e-3), rtol=1e-4)
    assert change.name == "change: steer_bias"
    assert change.t[0] == pytest.approx(5.5)


def test_what_was_not_learnt_has_no_panel(session):
    titles = [panel.title for panel in with_model(make_drawing(session), session).panels]
    assert titles == [title for title, _, fields, _ in PANELS if "steer_bias" in fields]
