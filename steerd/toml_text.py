"""The one reader of TOML: whatever a text holds, tables or one error within a fraction of a second.

It belongs to no room: car files, maps, lab and sweep files are read through it.
"""

import re
import tomllib
from pathlib import Path
from typing import Any

SIZE_MAX = 1_000_000  # a page of settings; what is larger is something else [bytes]
PARTS_MAX = 16  # parts of a dotted key: the parser's time grows with their square
DEPTH_MAX = 16
"""Tables and arrays within each other: what reads them later may call itself for each."""
MESSAGE_MAX = 200
"""A parser's message may quote the text; no more than this is repeated [characters]."""
_PART = r"""(?:[^\s.,\[\]{}=#"']+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_LONG_KEY = re.compile(rf"(?<![^\s,\[\]{{}}=#])(?:{_PART}[ \t]*\.[ \t]*){{{PARTS_MAX}}}")


class TomlError(ValueError):
    """A text that is no TOML, or more of it than anybody writes; one line."""


def load_toml(path: Path) -> dict[str, Any]:
    """The tables of a file.

    Raises:
        OSError: it cannot be read.
        TomlError: it is no TOML within the bounds.
    """
    return parse_toml(read_toml(path))


def read_toml(path: Path) -> str:
    """The text of a file, no more than it may hold.

    Raises:
        OSError: it cannot be read.
        TomlError: it is too large, or no UTF-8.
    """
    with path.open("rb") as file:
        return decode_toml(file.read(SIZE_MAX + 1))


def decode_toml(raw: bytes) -> str:
    """The text of a file's content.

    Raises:
        TomlError: it is too large, or no UTF-8.
    """
    if len(raw) > SIZE_MAX:
        raise TomlError(f"is larger than {SIZE_MAX / 1e6:g} MB")
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise TomlError(f"byte {error.start} is not UTF-8") from None


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a text.

    Raises:
        TomlError: it is no TOML within the bounds.
    """
    if len(text) > SIZE_MAX:
        raise TomlError(f"is larger than {SIZE_MAX / 1e6:g} MB")
    long_key = _LONG_KEY.search(text)
    if long_key:
        line = text.count("\n", 0, long_key.start()) + 1
        raise TomlError(f"a key of more than {PARTS_MAX} parts (at line {line})")
    try:
        tables = tomllib.loads(text)
    except (RecursionError, MemoryError):
        raise TomlError("nested too deeply") from None
    except ValueError as error:
        raise TomlError(str(error)[:MESSAGE_MAX]) from None
    _check_depth(tables)
    return tables


def _check_depth(tables: dict[str, Any]) -> None:
    level: list[Any] = [tables]
    for _ in range(DEPTH_MAX):
        inner = (v.values() if isinstance(v, dict) else v for v in level)
        level = [v for values in inner for v in values if isinstance(v, (dict, list))]
        if not level:
            return
    raise TomlError("nested too deeply")
