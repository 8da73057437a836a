"""What identify knows of a car beyond its values: a file for programs beside the one for people.

`car.toml` holds the values. Noise levels and the joint covariance lie in `car.posterior.json`, with
a digest of the values that the covariance lies about. Car files from before hold the same tables as
`[noise]` and `[knowledge]`. Like `steerd.toml_text`, it belongs to no room.
"""

import contextlib
import hashlib
import json
from collections.abc import Mapping
from math import isclose, nan
from pathlib import Path
from typing import Any

SCHEMA = "steerd.posterior/1"
ATTACHED = "car.posterior.json"  # what a session that holds a `car.toml` calls the file
TABLES = ("noise", "knowledge")
SIZE_MAX = 4_000_000  # a covariance of all parameters of all effects has a tenth of it [characters]

Tables = Mapping[str, Mapping[str, Any]]
"""`noise` and `knowledge` by name, as `steerd.sysid.inference` makes and reads them."""


def posterior_path(car: Path) -> Path:
    """Where the file of a car file lies."""
    return car.with_name(f"{car.stem}.posterior.json")


def read_beside(car: Path) -> str:
    """The text of the file of a car file; empty where there is none that can be read."""
    try:
        with posterior_path(car).open(encoding="utf-8", errors="replace") as file:
            return file.read(SIZE_MAX + 1)
    except OSError:
        return ""


def encode_posterior(numbers: Mapping[str, Any], tables: Tables) -> str:
    """The file's text: what is known of a car with these values, see `CarFile.numbers`."""
    content = {"schema": SCHEMA, "values": _digest(numbers), **tables}
    return json.dumps(content, separators=(",", ":"), allow_nan=False) + "\n"


def find_known(
    numbers: Mapping[str, Any], sections: Tables, text: str, name: str
) -> tuple[Tables, str]:
    """What is known of a car with these values: tables that hold, a sentence where one does not.

    The sections are those of the car file; from before they hold `[noise]` and `[knowledge]`. Text
    and name are of the file beside it, empty where there is none. Noise is of the drives and holds
    whatever the values are; the covariance lies about its own values only.
    """
    if text:
        content: Any = None
        with contextlib.suppress(ValueError, RecursionError):
            content = json.loads(text) if len(text) <= SIZE_MAX else None
        whole = isinstance(content, dict) and content.get("schema") == SCHEMA
        if not whole or not all(isinstance(content.get(key, {}), dict) for key in TABLES):
            return {}, f"{name} is not what identify writes: it is not used"
        known = {key: content[key] for key in TABLES if key in content}
        if content.get("values") == _digest(numbers):
            return known, ""
        known.pop("knowledge", None)
        return known, f"{name} is of other values than the car file has now: it is not used"
    known = {key: sections[key] for key in TABLES if key in sections}
    if "knowledge" in known and not _is_about(known["knowledge"], numbers):
        del known["knowledge"]
        return known, "the car file was edited since identify wrote [knowledge]: it is not used"
    return known, ""


def _digest(numbers: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()


def _is_about(table: Mapping[str, Any], numbers: Mapping[str, Any]) -> bool:
    """Whether a `[knowledge]` is of these values: all that it names, and no effect of it is new."""
    of, names = table.get("of"), table.get("names")
    if not isinstance(of, dict) or not isinstance(names, list):
        return True  # whoever reads the table says what is wrong with it
    new = [name for name in names if "." in str(name) and name in numbers and name not in of]
    try:
        same = all(isclose(numbers.get(n, nan), v, rel_tol=1e-9) for n, v in of.items())
    except TypeError:
        return False
    return same and not new
