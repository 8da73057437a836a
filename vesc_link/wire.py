"""Numbers as the VESC writes them: big-endian integers times a scale, and binary32.

The host rounds half away from zero, as VESC Tool does. The device multiplies in single precision
and truncates toward zero, and its numbers are reproduced bit for bit.
Source: `docs/reference/vesc-serial.md#v1.9` and following.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from operator import attrgetter, mul
from typing import Any, NamedTuple, get_type_hints

from steerd.vesc_link.ids import ALWAYS, Firmware

_RANGES = {
    "?": (0, 1),
    "b": (-(1 << 7), (1 << 7) - 1),
    "B": (0, (1 << 8) - 1),
    "h": (-(1 << 15), (1 << 15) - 1),
    "H": (0, (1 << 16) - 1),
    "i": (-(1 << 31), (1 << 31) - 1),
    "I": (0, (1 << 32) - 1),
}
_SMALLEST_F32 = 1.5e-38
"""Below this the firmware's float32_auto writes zero."""

Number = float | int


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """One number on the wire; compared by identity, which makes looking up a layout fast."""

    name: str  # field of the dataclass that holds it
    code: str  # its struct code; ``f`` is the firmware's float32_auto, ``?`` a flag byte
    scale: float | None = None  # wire counts per unit; None for a plain integer
    since: Firmware = ALWAYS  # first firmware that sends it

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return struct.calcsize(">" + self.code)


def wire_fields(cls: type[object]) -> tuple[Field, ...]:
    """What a class says of its fields behind their types: code, scale and since, as `Field` has."""
    hints = get_type_hints(cls, include_extras=True).items()
    return tuple(Field(name, *of.__metadata__) for name, of in hints if hasattr(of, "__metadata__"))


_SINGLE = struct.Struct(">f")


def to_f32(value: float) -> float:
    """Round to single precision.

    Raises:
        ValueError: not finite in single precision.
    """
    try:
        rounded: float = _SINGLE.unpack(_SINGLE.pack(value))[0]
    except OverflowError:
        rounded = math.inf
    if not -math.inf < rounded < math.inf:
        raise ValueError(f"{value} cannot be sent: {_FINITE}")
    return rounded


_FINITE = "the VESC's floats are finite single precision"


def host_number(code: str, scale: float | None, value: Number) -> Number:
    """Wire number as the host sends it: rounded half away from zero, refused if out of range.

    Raises:
        ValueError: NaN, infinity, or outside what the field holds.
    """
    if code == "f":
        return _saturated("f", to_f32(value))
    scaled = value * (1 if scale is None else scale)
    if not -math.inf < scaled < math.inf:
        raise ValueError(f"{value} cannot be sent to a VESC")
    count = math.floor(scaled + 0.5) if scaled >= 0 else -math.floor(0.5 - scaled)
    low, high = _RANGES[code]
    if not low <= count <= high:
        raise ValueError(f"{value} does not fit its field ({low} to {high} counts)")
    return count


def _saturated(code: str, value: Number) -> Number:
    if code == "f":
        return 0.0 if -_SMALLEST_F32 < value < _SMALLEST_F32 else value
    low, high = _RANGES[code]
    return min(max(int(value), low), high)


def pack_host(fields: tuple[Field, ...], record: object) -> bytes:
    """A record's fields in order, each as `host_number`.

    Raises:
        ValueError: a value is not finite or does not fit.
    """
    values = reader(fields)(record)
    numbers = [host_number(f.code, f.scale, v) for f, v in zip(fields, values, strict=True)]
    return _layout(fields).numbers.pack(*numbers)


def pack_device(fields: tuple[Field, ...], values: Sequence[Number]) -> bytes:
    """Values in order as the firmware sends them: single precision products, cut, saturated.

    Raises:
        ValueError: a value is not finite (a simulated device must not have one).
    """
    layout = _layout(fields)
    singles = layout.singles
    try:
        rounded = singles.unpack(singles.pack(*map(values.__getitem__, layout.measured)))
        products = singles.unpack(singles.pack(*map(mul, rounded, layout.scales)))
    except OverflowError:
        products = (math.inf,)
    if not -math.inf < sum(products) < math.inf:  # in double precision no sum of these overflows
        raise ValueError(f"{values} cannot be sent: {_FINITE}")
    numbers = list(values)
    for i, product in zip(layout.measured, products, strict=True):
        numbers[i] = 0.0 if -_SMALLEST_F32 < product < _SMALLEST_F32 else product
    try:
        return layout.numbers.pack(*(map(int, numbers) if layout.whole else numbers))
    except struct.error:  # one does not fit, or is no whole number among floats
        return layout.numbers.pack(*map(_saturated, layout.codes, numbers))


class _Layout(NamedTuple):
    """Fields in line: their bytes, names and codes; which are measured, in what scales."""

    numbers: struct.Struct
    names: tuple[str, ...]
    codes: tuple[str, ...]
    measured: tuple[int, ...]
    singles: struct.Struct
    """The measured ones in single precision."""
    scales: tuple[float, ...]
    whole: bool
    """Every field holds a whole number."""


@lru_cache(maxsize=128)
def _layout(fields: tuple[Field, ...]) -> _Layout:
    names, codes = tuple(f.name for f in fields), "".join(f.code for f in fields)
    measured = tuple(i for i, f in enumerate(fields) if f.code == "f" or f.scale is not None)
    scales = tuple(fields[i].scale or 1.0 for i in measured)
    numbers, singles = struct.Struct(">" + codes), struct.Struct(f">{len(measured)}f")
    return _Layout(numbers, names, tuple(codes), measured, singles, scales, "f" not in codes)


@lru_cache(maxsize=64)
def reader(fields: tuple[Field, ...]) -> Callable[[object], tuple[Any, ...]]:
    """What gives a record's value for each field."""
    if not fields:
        return lambda record: ()
    read = attrgetter(*(field.name for field in fields))
    return read if len(fields) > 1 else lambda record: (read(record),)


@lru_cache(maxsize=64)
def _layout_within(fields: tuple[Field, ...], size: int) -> _Layout:
    """Of the fields that lie whole within so many bytes."""
    ends = accumulate(field.size for field in fields)
    return _layout(tuple(f for f, end in zip(fields, ends, strict=True) if end <= size))


def unpack_fields(fields: tuple[Field, ...], payload: bytes, offset: int) -> dict[str, Any]:
    """Read fields in order until the payload ends; those beyond are absent."""
    layout = _layout_within(fields, len(payload) - offset)
    values = [*layout.numbers.unpack_from(payload, offset)]
    for i, scale in zip(layout.measured, layout.scales, strict=True):
        values[i] /= scale
    return dict(zip(layout.names, values, strict=True))


def all_finite(values: Mapping[str, Number]) -> bool:
    """Whether no value is NaN or infinite; a firmware sends neither, so such a packet is wrong."""
    for value in values.values():  # noqa: SIM110 - thrice as fast as a generator
        if not math.isfinite(value):
            return False
    return True
