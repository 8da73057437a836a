"""The pages on sessions, mocap and safety name what the code has, all of it and nothing else."""

import json
import re
import xml.etree.ElementTree as ET
from itertools import takewhile
from pathlib import Path

import pytest

from steerd.daemon.imports.import_map import ROLES, STREAM_COLUMNS, load_map, parse_map
from steerd.daemon.process.view import SCENE
from steerd.daemon.settings.config import FRAME_ANGLES
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.gates import REASONS
from steerd.mocap_link.source import ClockKind
from steerd.steer_bus.fields import Scalar, leaves_of
from steerd.steer_bus.topics import TOPICS, find_topic, make_session_topic
from tests.safety.report import write_thresholds

ROOT = Path(__file__).resolve().parents[4]
FRAME_KEYS = {f"{k}_deg" if k in FRAME_ANGLES else k for k in FrameConfig.__slots__}


def first_cells(page, head):
    """Names in backticks in the first column of the table under a head."""
    lines = (ROOT / "docs" / page).read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(head))
    rows = takewhile(lambda line: line.startswith("|"), lines[start + 2 :])
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])]


@pytest.mark.parametrize(("page", "head", "known"), [
    ("reference/sessions.md", "| topic |", {t.name for t in TOPICS}),
    ("reference/mocap.md", "| reason |", set(REASONS)),
    ("reference/mocap.md", "| `clock_kind` |", set(map(str, ClockKind))),
    ("reference/mocap.md", "| key |", FRAME_KEYS - {"cog_ahead_of_rear"}),
    ("how-to/import-logs.md", "| role |", set(ROLES)),
])  # fmt: skip
def test_all_that_the_code_has_is_explained_and_nothing_else(page, head, known):
    assert set(first_cells(page, head)) == known


def test_the_page_of_maps_names_every_column_and_it_and_the_examples_hold_maps():
    text = (ROOT / "docs" / "how-to" / "import-logs.md").read_text()
    assert all(f"`{name}`" in text for name in ("t", *STREAM_COLUMNS))
    the_map = parse_map(text.partition("```toml\n")[2].partition("```")[0])
    assert the_map.columns["throttle"].gate == "motor_on"
    examples = sorted((ROOT / "examples").glob("import-*.toml"))
    assert len(examples) >= 2
    for path in examples:
        assert "t" in load_map(path).columns


def test_thresholds_and_their_bounds_are_those_of_the_safety_page():
    page = (ROOT / "docs" / "reference" / "safety-watchdogs.md").read_text()
    assert "\n".join(write_thresholds()) in page


# The layouts in `examples/` name topics and fields that exist, and all of their own panels.
LAYOUT = json.loads((ROOT / "examples" / "foxglove-layout.json").read_text())
PANELS = LAYOUT["configById"].values()


def numbers(separator):
    """Every number that is published, such as `/steerd/car1/state<separator>e1`."""
    return {
        separator.join((make_session_topic("car1", topic), *leaf.name.split(".")))
        for topic in TOPICS for leaf in leaves_of(topic.message) if isinstance(leaf.kind, Scalar)
    }  # fmt: skip


def test_layouts_plot_numbers_that_exist():
    plotted = {path["value"] for panel in PANELS for path in panel.get("paths", [])}
    curves = ET.parse(ROOT / "examples" / "plotjuggler-layout.xml").iter("curve")
    assert len(plotted) > 3
    assert plotted <= numbers(".")
    assert {curve.get("name") for curve in curves} <= numbers("/")


def test_foxglove_panels_look_at_topics_that_exist():
    keys = ("topicToRender", "topicPath")
    named = [panel[key] for panel in PANELS for key in keys if key in panel]
    assert len(named) == 3
    drawn = set(LAYOUT["configById"]["3D!lane"]["topics"])
    assert SCENE in drawn
    for topic in (*named, *(drawn - {SCENE})):
        assert find_topic(topic) is not None, topic
