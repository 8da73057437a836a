"""Set values in a car file; comments, order and everything else stay."""

# Why: docs/decisions/rooms-and-code.md#d28

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from steerd.car_model.car_file import CarFile, CarFileError, parse_car
from steerd.daemon.common.translate import make_car_file_error
from steerd.daemon.settings.config import make_settings

Values = Mapping[tuple[str, str], float | str]  # new values by (section, key)


def edit_car(base: CarFile, values: Values) -> CarFile:
    """The car file with new values; sections and keys that it lacks are added.

    Raises SteerdError: the result would not be a valid car file.
    """
    document = tomlkit.parse(base.text)
    edit_document(document, values)
    try:
        car = parse_car(tomlkit.dumps(document), Path("the new car file"), base.posterior)
        make_settings(car)
    except CarFileError as error:
        raise make_car_file_error(error) from None
    return car


def edit_document(document: Any, values: Values) -> None:
    """Set values in the TOML document of a car file."""
    for (section, key), value in values.items():
        table: Any = document.setdefault(section, tomlkit.table())
        old = table.get(key)
        table[key] = value
        if old is not None and hasattr(old, "trivia"):
            table[key].trivia.comment = old.trivia.comment
            table[key].trivia.comment_ws = old.trivia.comment_ws
