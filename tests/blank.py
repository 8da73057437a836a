"""Messages for tests: numbers that are 0 but for those that a test gives, or all drawn."""

from typing import Any

import numpy as np

from steerd.steer_bus.fields import Nested, Scalar, Sized, message_fields
from steerd.steer_bus.messages import BODY, WORLD, make_header
from steerd.steer_bus.standard import DiagnosticArray, DiagnosticStatus, KeyValue

NOW_NS = 1_500_000_000_250_000_000  # UNIX time of their headers


def blank(cls: type, **values: Any) -> Any:
    """A message of numbers and a header."""
    zeros = dict.fromkeys(cls.__dataclass_fields__, 0)
    return cls(**{**zeros, "header": make_header(NOW_NS, WORLD), **values})


def status_message(name: str = "steerd: supervisor", **values: str) -> DiagnosticArray:
    """Diagnostics with these values of one node."""
    pairs = tuple(KeyValue(key, value) for key, value in values.items())
    return DiagnosticArray(make_header(0, BODY), (DiagnosticStatus(0, name, "", "", pairs),))


def drawn(cls: type, rng: np.random.Generator) -> Any:
    """A message of random values."""
    return cls(*[_value(field.kind, rng) for field in message_fields(cls)])


def _value(kind: Any, rng: np.random.Generator) -> Any:
    match kind:
        case Sized(is_text=True):
            return "tyre µ"[: int(rng.integers(7))]
        case Sized():
            return rng.bytes(int(rng.integers(20)))
        case Scalar(count=count) if count:
            return tuple(rng.normal(size=count).tolist())
        case Nested(many=True):
            return tuple(drawn(kind.cls, rng) for _ in range(int(rng.integers(3))))
        case Nested():
            return drawn(kind.cls, rng)
        case Scalar(code="d" | "f"):
            return float(np.float32(rng.normal()))
    return int(rng.integers(100))
