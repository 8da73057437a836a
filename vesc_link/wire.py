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
from operator import attrgetter, mul, truediv
from typing import Any, NamedTuple

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
    return _struct(fields).pack(*numbers)


def pack_device(fields: tuple[Field, ...], values: Sequence[Number]) -> bytes:
    """Values in order as the firmware sends them: single precision products, cut, saturated.

    Raises:
        ValueError: a value is not finite (a simulated device must not have one).
    """
    layout = _device_layout(fields)
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
        return _struct(fields).pack(*(map(int, numbers) if layout.whole else numbers))
    except struct.error:  # one does not fit, or is no whole number among floats
        return _struct(fields).pack(*map(_saturated, layout.codes, numbers))


class _DeviceLayout(NamedTuple):
    """Which fields are measured in single precision, their scales, and what each field holds."""

    measured: tuple[int, ...]
    singles: struct.Struct
    scales: tuple[float, ...]
    codes: tuple[str, ...]
    whole: bool
    """Every field holds a whole number."""


@lru_cache(maxsize=64)
def _device_layout(fields: tuple[Field, ...]) -> _DeviceLayout:
    measured = tuple(i for i, f in enumerate(fields) if f.code == "f" or f.scale is not None)
    codes = tuple(f.code for f in fields)
    scales = tuple(fields[i].scale or 1.0 for i in measured)
    singles = struct.Struct(f">{len(measured)}f")
    return _DeviceLayout(measured, singles, scales, codes, "f" not in codes)


@lru_cache(maxsize=64)
def reader(fields: tuple[Field, ...]) -> Callable[[object], tuple[Any, ...]]:
    """What gives a record's value for each field."""
    if not fields:
        return lambda record: ()
    read = attrgetter(*(field.name for field in fields))
    return read if len(fields) > 1 else lambda record: (read(record),)


@lru_cache(maxsize=64)
def _struct(fields: tuple[Field, ...]) -> struct.Struct:
    return struct.Struct(">" + "".join(f.code for f in fields))


class _Layout(NamedTuple):
    """Fields that lie whole within a payload: their bytes; names, and scales of which."""

    numbers: struct.Struct
    names: tuple[str, ...]
    scaled: tuple[str, ...]
    scales: tuple[float, ...]


@lru_cache(maxsize=64)
def _layout(fields: tuple[Field, ...], size: int) -> _Layout:
    present: list[Field] = []
    left = size
    for field in fields:
        left -= field.size
        if left < 0:
            break
        present.append(field)
    measured = {f.name: f.scale for f in present if f.scale is not None}
    names = tuple(f.name for f in present)
    return _Layout(_struct(tuple(present)), names, tuple(measured), tuple(measured.values()))


def unpack_fields(fields: tuple[Field, ...], payload: bytes, offset: int) -> dict[str, Any]:
    """Read fields in order until the payload ends; those beyond are absent."""
    layout = _layout(fields, len(payload) - offset)
    values = dict(zip(layout.names, layout.numbers.unpack_from(payload, offset), strict=True))
    counts = map(values.__getitem__, layout.scaled)
    values.update(zip(layout.scaled, map(truediv, counts, layout.scales), strict=True))
    return values


def all_finite(values: Mapping[str, Number]) -> bool:
    """Whether no value is NaN or infinite; a firmware sends neither, so such a packet is wrong."""
    for value in values.values():  # noqa: SIM110 - thrice as fast as a generator
        if not math.isfinite(value):
            return False
    return True
