"""What a car file says beside the car: taken from the drives where nobody named a car file.

A drive knows its motor's ERPM per m/s, its mocap body and its limits. A car file with F1TENTH's
instead would send the driven car off with another car's wiring.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import CarFile, default_car_path
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.settings.car_edit import Values, edit_text
from steerd.steer_bus.session import Session, SessionError, open_session
from steerd.toml_text import TomlError, decode_toml, parse_toml

_LEARNT = ("car", "effects", "noise", "knowledge")
"""Sections that the identification itself writes, or that are about another car's numbers."""


def with_wiring(text: str, base: CarFile, sessions: Sequence[Path]) -> str:
    """The car file's text with the drives' own wiring, where it began as F1TENTH's file.

    Args:
        text: of the new car file.
        base: the car file it began as; one that somebody named has its own wiring.
        sessions: the drives.
    """
    values = find_wiring(base, sessions)
    try:
        return edit_text(text, values) if values else text
    except SteerdError:  # a drive of a version whose settings were others: the result counts more
        return text


def find_wiring(base: CarFile, sessions: Sequence[Path]) -> Values:
    """Settings of the drives that differ from the base's; none where the drives differ too."""
    if base.path != default_car_path():
        return {}
    found = [_read_wiring(path) for path in sessions]
    known = _flatten(parse_toml(base.text))
    same = found[0] if found and all(each == found[0] for each in found) else {}
    return {key: value for key, value in same.items() if known.get(key) != value}


def _read_wiring(path: Path) -> Values:
    try:
        session = open_session(path)
    except SessionError:
        return {}
    try:
        return _flatten(parse_toml(decode_toml(session.attachment("car.toml"))))
    except (SessionError, TomlError):
        return dict(_stated(session))


def _stated(session: Session) -> Iterable[tuple[tuple[str, str], float]]:
    """What somebody stated about the motor at an import."""
    for key in session.info().metadata.get("steerd.scaling", {}):
        yield ("vesc", key), session.number("steerd.scaling", key, 0.0)


def _flatten(document: Mapping[str, Any]) -> Values:
    return {
        (section, key): value
        for section, table in document.items()
        if section not in _LEARNT and isinstance(table, dict)
        for key, value in table.items()
    }
