"""Messages whose numbers are 0, but for those that a test gives."""

from typing import Any

from steerd.steer_bus.messages import WORLD, make_header

NOW_NS = 1_500_000_000_250_000_000
"""UNIX time of their headers."""


def blank(cls: type, **values: Any) -> Any:
    """A message of numbers and a header."""
    zeros = dict.fromkeys(cls.__dataclass_fields__, 0)
    return cls(**{**zeros, "header": make_header(NOW_NS, WORLD), **values})
