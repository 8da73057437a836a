"""The pages on sessions and mocap name what the code has, all of it and nothing else."""

import re
from pathlib import Path

from steerd.daemon.imports.import_map import ROLES, STREAM_COLUMNS, load_map, parse_map
from steerd.daemon.settings.config import FRAME_ANGLES
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.gates import REASONS
from steerd.mocap_link.source import ClockKind
from steerd.steer_bus.topics import TOPICS

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


def test_every_topic_is_explained():
    assert sorted(first_cells("reference/sessions.md", "| topic |")) == sorted(
        t.name for t in TOPICS
    )


def test_every_gate_is_explained():
    assert sorted(first_cells("reference/mocap.md", "| reason |")) == sorted(REASONS)


def test_every_clock_is_explained():
    assert first_cells("reference/mocap.md", "| `clock_kind` |") == [
        str(kind) for kind in ClockKind
    ]


def test_every_frame_key_is_explained():
    keys = first_cells("reference/mocap.md", "| key |")
    known = {f"{k}_deg" if k in FRAME_ANGLES else k for k in FrameConfig.__slots__}
    assert {*keys, "cog_ahead_of_rear"} == known


def test_every_role_and_column_is_explained():
    assert tuple(first_cells("how-to/import-logs.md", "| role |")) == ROLES
    text = (ROOT / "docs" / "how-to" / "import-logs.md").read_text()
    assert all(f"`{name}`" in text for name in ("t", *STREAM_COLUMNS))


def test_the_map_on_the_page_is_one():
    text = (ROOT / "docs" / "how-to" / "import-logs.md").read_text()
    the_map = parse_map(text.partition("```toml\n")[2].partition("```")[0])
    assert the_map.columns["throttle"].gate == "motor_on"
    assert the_map.frame is not None


def test_the_examples_are_maps():
    examples = sorted((ROOT / "examples").glob("import-*.toml"))
    assert len(examples) >= 2
    for path in examples:
        assert "t" in load_map(path).columns
