"""One live parameter as text, `set NAME VALUE`: from a page or a viewer, who hold no codec."""

import contextlib
from math import isfinite

LIVE = ("speed", "offset", "gain")
"""Live parameters by name: [m/s], [m], a share."""
SETTING_MAX = 64
"""Longest such text [bytes]."""


def format_setting(name: str, value: float) -> str:
    """The text of a setting."""
    return f"set {name} {value!r}"


def parse_setting(text: str) -> dict[str, float] | None:
    """The live parameter of such a text; None if it is none, or not finite."""
    match text.split():
        case ["set", name, value] if name in LIVE:
            with contextlib.suppress(ValueError):
                number = float(value)
                return {name: number} if isfinite(number) else None
    return None
