"""Pages that repeat what the code says: the commands' options and the car file's sections."""

import re
import tomllib
from pathlib import Path

from tests.contract.command_page import PAGE, make_page

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_commands_is_what_the_parsers_say() -> None:
    hint = "run python -m tests.contract.command_page"
    assert PAGE.read_text(encoding="utf-8") == make_page(), hint


def test_every_section_of_a_car_file_is_explained() -> None:
    text = (ROOT / "docs" / "reference" / "car-file.md").read_text(encoding="utf-8")
    explained = set(re.findall(r"^\| `\[([a-z]+)\]`", text, re.MULTILINE))
    sections = tomllib.loads((ROOT / "config" / "f1tenth.toml").read_text(encoding="utf-8"))
    assert set(sections) <= explained
