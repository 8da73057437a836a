"""Set values in a car file; comments, order and everything else stay."""

# Why: docs/decisions/rooms-and-code.md#d28

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from steerd.car_model.car_file import CarFileError, load_car, parse_car
from steerd.daemon.common.translate import make_car_file_error
from steerd.daemon.settings.config import make_settings

Values = Mapping[tuple[str, str], float | str]
"""New values by (section, key)."""


def load_text(path: Path) -> str:
    """The text of a valid car file.

    Raises:
        SteerdError: it cannot be read, or it is invalid.
    """
    try:
        return load_car(path).text
    except CarFileError as error:
        raise make_car_file_error(error) from None


def edit_text(text: str, values: Values) -> str:
    """The text with new values; sections and keys that it lacks are added.

    Raises:
        SteerdError: the result would not be a valid car file.
    """
    document = tomlkit.parse(text)
    for (section, key), value in values.items():
        table: Any = document.setdefault(section, tomlkit.table())
        old = table.get(key)
        table[key] = value
        if old is not None and hasattr(old, "trivia"):
            table[key].trivia.comment = old.trivia.comment
            table[key].trivia.comment_ws = old.trivia.comment_ws
    new = tomlkit.dumps(document)
    try:
        make_settings(parse_car(new, Path("the new car file")))
    except CarFileError as error:
        raise make_car_file_error(error) from None
    return new
