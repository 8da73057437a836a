"""Pages repeat what the code says, and no room is larger than recorded."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from tests.contract.command_page import PAGE, make_page
from tests.contract.size import GOALS, recorded, sizes

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_commands_is_what_the_parsers_say():
    hint = "run python -m tests.contract.command_page"
    assert PAGE.read_text(encoding="utf-8") == make_page(), hint


def test_every_section_of_a_car_file_is_explained():
    text = (ROOT / "docs" / "reference" / "car-file.md").read_text(encoding="utf-8")
    explained = set(re.findall(r"^\| `\[([a-z]+)\]`", text, re.MULTILINE))
    sections = tomllib.loads((ROOT / "config" / "f1tenth.toml").read_text(encoding="utf-8"))
    assert set(sections) <= explained


# No room grows.


def test_no_room_is_larger_than_recorded():
    try:
        now = sizes()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout: what belongs to a room cannot be listed")
    larger = {r: (now[r], most) for r, most in recorded().items() if now[r] > most}
    assert not larger, f"(lines, recorded) {larger}: a change that adds lines takes as many away"


def test_every_room_has_a_recorded_size():
    assert set(recorded()) == set(GOALS)
