"""MCAP records from bytes: fields within their bounds, chunks within the caps, CRCs checked.

Source: the MCAP specification (mcap.dev/spec), opcodes and field orders.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import lz4.frame  # type: ignore[import-untyped]
import zstandard

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 64 << 20
"""Largest record body and largest decompressed chunk [bytes]."""
MAX_RATIO = 200
"""Highest compression ratio believed of a chunk above ``FREE_SIZE``."""
FREE_SIZE = 2 << 20
"""Decompressed size up to which any ratio is harmless [bytes]; our own chunks are half of it."""

COMPRESSIONS = ("", "zstd", "lz4")
CHUNK_START_SIZE = 44
"""How much of a chunk's body :func:`plausible_chunk` looks at [bytes]."""

SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX = 0x03, 0x04, 0x05, 0x06, 0x07
ATTACHMENT, METADATA, DATA_END = 0x09, 0x0C, 0x0F
HEADER, FOOTER, LAST_OPCODE = 0x01, 0x02, 0x0F

RECORD = struct.Struct("<BQ")
_MESSAGE_START = struct.Struct("<BQH")
FOOTER_FIELDS = struct.Struct("<QQI")
MESSAGE_FIELDS = struct.Struct("<IQQ")
"""What precedes a message's data behind its channel id: sequence, log time, publish time."""
MESSAGE_PREFIX = RECORD.size + 2
_MESSAGE_MIN = 2 + MESSAGE_FIELDS.size


class DamageError(Exception):
    """A record that is not what it claims to be."""


@dataclass(frozen=True, slots=True)
class Schema:
    """A schema record."""

    name: str
    encoding: str
    text: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel record."""

    topic: str
    encoding: str
    schema_id: int
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Attachment:
    """Where an attachment lies in the file."""

    name: str
    media_type: str
    create_ns: int
    log_ns: int
    offset: int
    size: int


def scan_messages(data: bytes) -> tuple[dict[int, list[tuple[int, int]]], list[tuple[int, bytes]]]:
    """Find the messages of a run of records by channel, and the other records.

    Returns:
        For each channel id the (start, end) of each message behind its channel id, in order; and
        (opcode, body) of each record that is no message.

    Raises:
        DamageError: if lengths do not add up.
    """
    found: dict[int, list[tuple[int, int]]] = {}
    others: list[tuple[int, bytes]] = []
    unpack, pos, end = _MESSAGE_START.unpack_from, 0, len(data)
    while pos < end:
        try:
            opcode, length, channel = unpack(data, pos)
        except struct.error as error:
            raise DamageError("a record is cut") from error
        start, pos = pos, pos + 9 + length
        if pos > end:
            raise DamageError("a record is longer than its chunk")
        if opcode != MESSAGE:
            others.append((opcode, data[start + 9 : pos]))
        elif length < _MESSAGE_MIN:
            raise DamageError("a message is cut")
        elif channel in found:
            found[channel].append((start + MESSAGE_PREFIX, pos))
        else:
            found[channel] = [(start + MESSAGE_PREFIX, pos)]
    return found, others


def iter_messages(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (channel id, start, end) of each message of a checked span in file order."""
    pos, end = 0, len(data)
    while pos < end:
        opcode, length, channel = _MESSAGE_START.unpack_from(data, pos)
        if opcode == MESSAGE:
            yield channel, pos + MESSAGE_PREFIX, pos + RECORD.size + length
        pos += RECORD.size + length


def read_attachment(body: bytes, pos: int) -> Attachment:
    """Check the attachment whose record starts at ``pos`` and say where its data lies.

    Raises:
        DamageError: if it is cut or fails its CRC.
    """
    fields = Fields(body)
    log_ns, create_ns = fields.number("<Q"), fields.number("<Q")
    name, media_type = fields.text(), fields.text()
    size = fields.number("<Q")
    start = fields.skip(size)
    crc = fields.number("<I")
    fields.end()
    if crc not in (0, zlib.crc32(body[:-4])):
        raise DamageError(f"attachment {name!r} fails its CRC")
    return Attachment(name, media_type, create_ns, log_ns, pos + RECORD.size + start, size)


def check_index(body: bytes) -> None:
    """Check the framing of a message index.

    Raises:
        DamageError: if its length does not add up.
    """
    # Nothing here uses the index, but a flipped opcode must not hide a chunk behind it.
    if len(body) < 6 or struct.unpack_from("<I", body, 2)[0] != len(body) - 6:
        raise DamageError("bad message index")


def open_chunk(body: bytes) -> bytes:
    """Decompress a chunk's records within the caps and check its CRC.

    Raises:
        DamageError: on a wrong size or CRC, a compression that is unknown or fails, or a ratio
            above ``MAX_RATIO`` (a bomb).
    """
    fields = Fields(body)
    fields.skip(16)
    size, crc, compression = fields.number("<Q"), fields.number("<I"), fields.text()
    raw = fields.raw(fields.number("<Q"))
    fields.end()
    if size > MAX_RECORD or (size > FREE_SIZE and size > MAX_RATIO * len(raw)):
        raise DamageError(f"{len(raw)} bytes claim to unpack to {size}")
    data = _decompress(raw, size, compression)
    if len(data) != size:
        raise DamageError("wrong decompressed size")
    if crc not in (0, zlib.crc32(data)):
        raise DamageError("CRC mismatch")
    return data


def _decompress(raw: bytes, size: int, compression: str) -> bytes:
    try:
        if compression == "":
            return raw
        if compression == "zstd":
            if zstandard.frame_content_size(raw) > size:
                raise DamageError("the chunk's size is a lie")
            return zstandard.ZstdDecompressor().decompress(raw, max_output_size=size)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(raw, max_length=size))
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamageError(f"does not decompress ({error})") from error
    raise DamageError(f"unknown compression {compression!r}")


@dataclass(slots=True)
class Fields:
    """Reads the fields of one record's body; DamageError where they would leave it."""

    body: bytes
    pos: int = 0

    def skip(self, size: int) -> int:
        """Pass over ``size`` bytes and give where they start."""
        start = self.pos
        if size > len(self.body) - start:
            raise DamageError("a record's fields do not fit it")
        self.pos += size
        return start

    def number(self, code: str) -> int:
        """Read one number by its ``struct`` code."""
        value: int = struct.unpack_from(code, self.body, self.skip(struct.calcsize(code)))[0]
        return value

    def raw(self, size: int | None = None) -> bytes:
        """Read ``size`` bytes, or as many as a ``uint32`` in front of them says."""
        size = self.number("<I") if size is None else size
        start = self.skip(size)
        return self.body[start : start + size]

    def text(self) -> str:
        """Read a string."""
        try:
            return self.raw().decode()
        except UnicodeDecodeError as error:
            raise DamageError("a name is not UTF-8") from error

    def text_map(self) -> dict[str, str]:
        """Read a map of strings."""
        inner = Fields(self.raw())
        found = {}
        while inner.pos < len(inner.body):
            key = inner.text()
            found[key] = inner.text()
        return found

    def end(self) -> None:
        """Check that nothing is left."""
        if self.pos != len(self.body):
            raise DamageError("a record is longer than its fields")


def plausible_chunk(start: bytes, length: int) -> bool:
    """Say whether a record body of ``length`` bytes that begins with ``start`` frames a chunk."""
    fields = Fields(start)
    try:
        fields.skip(28)
        compression = fields.text()
        size = fields.number("<Q")
    except DamageError:
        return False
    return compression in COMPRESSIONS and fields.pos + size == length
