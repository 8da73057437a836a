"""Recorded messages to NumPy columns, a whole topic at once.

All messages of a topic share one layout as long as their texts (the frame, mostly) keep their
length; then a topic is one ``np.frombuffer`` over the joined records. Texts and bytes that end a
message may vary. Records that do not share one are halved until they do.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.steer_bus.codec import MAX_BYTES, MAX_TRAILING, CodecError, decode, read_steps
from steerd.steer_bus.container import MESSAGE_FIELDS
from steerd.steer_bus.fields import Field, Scalar, Sized, flat_leaves, type_name

Columns = dict[str, NDArray[Any]]
"""``log_ns``, ``publish_ns``, ``sequence`` and each field by its (dotted) name, all of length n;
a header gives ``stamp_ns``. Fixed arrays are (n, count); texts and bytes at a message's end are
object arrays, those inside it (frame names) are left out."""

_PREFIX = MESSAGE_FIELDS.size
_CDR = _PREFIX + 4
_LITTLE_ENDIAN = 0x0100  # bytes 00 01 read as uint16
_CDR_HEADER = "#cdr"
_BATCH = 8192


class ColumnBuilder:
    """Collects one topic's records and turns them into columns in batches.

    Raises:
        TypeError: if the class holds a sequence of messages and so has no columns.
        CodecError: later on, if a record is not the message.
    """

    def __init__(self, cls: type[Any]) -> None:
        leaves = flat_leaves(cls)
        if leaves is None:
            raise TypeError(f"{type_name(cls)} has no columns: read it with messages()")
        self._cls, self._leaves = cls, leaves
        self._records: list[bytes] = []
        self._parts: list[Columns] = []

    def add(self, records: list[bytes]) -> None:
        """Add records (what follows a message's channel id in the file).

        Raises:
            CodecError: if one of them is not the message.
        """
        self._records += records
        if len(self._records) >= _BATCH:
            self._convert()

    def finish(self) -> Columns:
        """Give the columns of all records, in order.

        Raises:
            CodecError: if one of them is not the message.
        """
        if self._records or not self._parts:
            self._convert()
        names = self._parts[0].keys()
        columns = {n: np.concatenate([part[n] for part in self._parts]) for n in names}
        if "header.stamp.sec" in columns:
            seconds = columns.pop("header.stamp.sec").astype("i8")
            columns["stamp_ns"] = seconds * 1_000_000_000 + columns.pop("header.stamp.nanosec")
        return columns

    def _convert(self) -> None:
        self._parts += self._read(self._records)
        self._records = []

    def _read(self, records: list[bytes]) -> list[Columns]:
        columns, middle = _read_columns(self._leaves, records), len(records) // 2
        if columns is not None:
            return [columns]
        if not middle:
            decode(self._cls, records[0][_PREFIX:])  # says what is wrong with it
            raise CodecError(f"{type_name(self._cls)}: its lengths do not add up")
        return self._read(records[:middle]) + self._read(records[middle:])


def _read_columns(leaves: tuple[Field, ...], records: list[bytes]) -> Columns | None:
    """Read records of one layout at once; None if they do not share it."""
    numbers = (i for i, leaf in enumerate(leaves) if isinstance(leaf.kind, Scalar))
    fixed = 1 + max(numbers, default=-1)
    found = _layout(leaves[:fixed], records[0] if records else bytes(MAX_BYTES))
    if found is None:
        return None
    dtype, texts = found
    size = dtype.itemsize
    lengths = np.fromiter(map(len, records), np.int64, len(records))
    longest = np.inf if leaves[fixed:] else size + MAX_TRAILING
    if records and (lengths.min() < size or lengths.max() > longest):
        return None
    whole = bool((lengths == size).all())
    table = np.frombuffer(b"".join(records if whole else [r[:size] for r in records]), dtype)
    if (table[_CDR_HEADER] != _LITTLE_ENDIAN).any():
        return None
    if any((table[name] != length).any() for name, length in texts.items()):
        return None
    columns = {name: table[name].copy() for name in dtype.names or () if "#" not in name}
    tails = _tail_columns(leaves[fixed:], records, size)
    return None if tails is None else columns | tails


def _layout(leaves: tuple[Field, ...], first: bytes) -> tuple[np.dtype[Any], dict[str, int]] | None:
    """Give the layout of records like ``first`` and the length each text in it must have."""
    columns: list[tuple[str, Any, int]] = [
        ("sequence", "<u4", 0), ("log_ns", "<i8", 4), ("publish_ns", "<i8", 12),
        (_CDR_HEADER, "<u2", _PREFIX),
    ]  # fmt: skip
    at, texts = _CDR, {}
    for leaf in leaves:
        if isinstance(kind := leaf.kind, Scalar):
            at += (_CDR - at) % kind.size
            form = f"<{kind.code}"
            columns.append((leaf.name, (form, (kind.count,)) if kind.count else form, at))
            at += kind.size * (kind.count or 1)
        else:
            at += (_CDR - at) % 4
            columns.append((f"{leaf.name}#", "<u4", at))
            texts[f"{leaf.name}#"] = length = int.from_bytes(first[at : at + 4], "little")
            at += 4 + length
        if at > len(first):
            return None
    layout = dict(zip(("names", "formats", "offsets"), zip(*columns, strict=True), strict=True))
    return np.dtype(layout | {"itemsize": at}), texts  # type: ignore[call-overload]


def _tail_columns(leaves: tuple[Field, ...], records: list[bytes], start: int) -> Columns | None:
    columns: Columns = {leaf.name: np.empty(len(records), object) for leaf in leaves}
    texts = tuple(leaf.kind for leaf in leaves if isinstance(leaf.kind, Sized))
    for row, record in enumerate(records if texts else ()):
        values: list[Any] = []
        try:
            end = read_steps(texts, record, start, values)
        except (CodecError, struct.error, UnicodeError):
            return None
        if len(record) - end > MAX_TRAILING:
            return None
        for column, value in zip(columns.values(), values, strict=True):
            column[row] = value
    return columns
