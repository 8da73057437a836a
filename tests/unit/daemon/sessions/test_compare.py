"""Drives of one lane side by side."""

import numpy as np
import pytest

from steerd.car_model.path.path_spec import parse_path
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.sessions.compare import LaneSession, check_same_lane, render_comparison
from steerd.sysid.report.drawing import LINES

CIRCLE = parse_path("circle:radius=2")


def drive(name="a.mcap", offset=0.0, lane=CIRCLE):
    along = np.linspace(0.0, 2.0 * lane.length, 5000)
    wave = 0.02 * np.sin(2.0 * np.pi * along / lane.length)
    values = {"e1": wave + offset, "e2": 0.1 * wave, "speed": 1.0 + wave, "steer_ref": wave}
    return LaneSession(name, lane.name, lane, None, along % lane.length, values, 2.0)


def test_places_of_different_lanes_are_not_compared():
    check_same_lane([drive(), drive("b.mcap")])
    other = drive("b.mcap", lane=parse_path("circle:radius=2.2"))
    with pytest.raises(SteerdError, match=r"b\.mcap"):
        check_same_lane([drive(), other])
    with pytest.raises(SteerdError, match="at most"):
        check_same_lane([drive()] * (len(LINES) + 1))


def test_the_page_names_the_drives_and_their_errors():
    page = render_comparison([drive("before.mcap", 0.03), drive("<b>.mcap", 0.001)])
    assert "before.mcap" in page
    assert "<b>" not in page
    assert "+30.0" in page
    assert page.count("<svg") == 5
