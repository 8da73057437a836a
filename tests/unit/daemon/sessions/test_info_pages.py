"""The pages on sessions and mocap name what the code has, all of it and nothing else."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from steerd.daemon.imports.import_map import ROLES, STREAM_COLUMNS, load_map, parse_map
from steerd.daemon.process.view import SCENE
from steerd.daemon.settings.config import FRAME_ANGLES
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.gates import REASONS
from steerd.mocap_link.source import ClockKind
from steerd.steer_bus.fields import Nested, Scalar, message_fields
from steerd.steer_bus.topics import TOPICS, find_topic

ROOT = Path(__file__).resolve().parents[4]


def first_cells(page, head):
    """Names in backticks in the first column of the table under a head."""
    lines = (ROOT / "docs" / page).read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(head))
    names = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        names += re.findall(r"`([^`]+)`", line.split("|")[1])
    return names


FRAME_KEYS = {f"{k}_deg" if k in FRAME_ANGLES else k for k in FrameConfig.__slots__}


@pytest.mark.parametrize(
    ("page", "head", "known"),
    [
        ("reference/sessions.md", "| topic |", {t.name for t in TOPICS}),
        ("reference/mocap.md", "| reason |", set(REASONS)),
        ("reference/mocap.md", "| `clock_kind` |", set(map(str, ClockKind))),
        ("reference/mocap.md", "| key |", FRAME_KEYS - {"cog_ahead_of_rear"}),
        ("how-to/import-logs.md", "| role |", set(ROLES)),
    ],
)
def test_all_that_the_code_has_is_explained_and_nothing_else(page, head, known):
    assert set(first_cells(page, head)) == known


def test_the_page_of_maps_names_every_column_and_holds_a_map():
    text = (ROOT / "docs" / "how-to" / "import-logs.md").read_text()
    assert all(f"`{name}`" in text for name in ("t", *STREAM_COLUMNS))
    the_map = parse_map(text.partition("```toml\n")[2].partition("```")[0])
    assert the_map.columns["throttle"].gate == "motor_on"


def test_the_examples_are_maps():
    examples = sorted((ROOT / "examples").glob("import-*.toml"))
    assert len(examples) >= 2
    for path in examples:
        assert "t" in load_map(path).columns


# The layouts in `examples/` name topics and fields that exist, and all of their own panels.

EXAMPLES = Path(__file__).resolve().parents[4] / "examples"
LAYOUT = json.loads((EXAMPLES / "foxglove-layout.json").read_text())


def field_kind(path, separator):
    """The wire kind of `/steerd/car1/state<separator>e1`; None where there is no such field."""
    car = re.match(r"/steerd/car1/", path)
    topic, *names = path[car.end() :].split(separator) if car else [""]
    found = find_topic(f"/steerd/car1/{topic}")
    if found is None:
        return None
    cls, kind = found.message, None
    for name in names:
        kind = {f.name: f.kind for f in message_fields(cls)}.get(name)
        cls = kind.cls if isinstance(kind, Nested) else None
    return kind


def plotted():
    return [path for panel in LAYOUT["configById"].values() for path in panel.get("paths", [])]


def curves():
    return list(ET.parse(EXAMPLES / "plotjuggler-layout.xml").iter("curve"))


@pytest.mark.parametrize("path", plotted(), ids=lambda path: path["value"])
def test_foxglove_plots_numbers_that_exist(path):
    assert isinstance(field_kind(path["value"], "."), Scalar)


def test_foxglove_panels_look_at_topics_that_exist():
    named = [
        panel[key]
        for panel in LAYOUT["configById"].values()
        for key in ("topicToRender", "topicPath")
        if key in panel
    ]
    assert len(named) == 3
    drawn = set(LAYOUT["configById"]["3D!lane"]["topics"])
    assert SCENE in drawn
    for topic in (*named, *(drawn - {SCENE})):
        assert find_topic(topic) is not None, topic


@pytest.mark.parametrize("curve", curves(), ids=lambda curve: curve.get("name"))
def test_plotjuggler_plots_numbers_that_exist(curve):
    assert isinstance(field_kind(curve.get("name"), "/"), Scalar)
