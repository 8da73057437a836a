"""The MCAP container as it may really be found: unfinished, damaged, foreign or hostile.

The mcap library parses the records. It trusts what a file says of itself, so :func:`read_contents`
bounds every size before, unpacks the chunks within theirs, checks every CRC, skips damaged records
to the next one that makes sense, and says what it skipped. It holds one record at a time: memory is
bounded by the caps, whatever the file claims.

Source: the MCAP specification (mcap.dev/spec), opcodes and field orders.
"""

# Why: docs/decisions/messages-and-sessions.md#d17

import io
import os
import re
import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar, cast

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap import records as rec  # noqa: TID251
from mcap.data_stream import ReadDataStream  # noqa: TID251
from mcap.opcode import Opcode  # noqa: TID251

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 64 << 20  # largest record body and largest decompressed chunk [bytes]
MAX_RATIO = 200  # highest compression ratio believed of a chunk above ``FREE_SIZE``
FREE_SIZE = 2 << 20
"""Decompressed size up to which any ratio is harmless [bytes]; our own chunks are half of it."""
MAX_CHANNELS = 4096
MAX_RESYNC = 64 << 20  # how far behind damage the next good record is looked for [bytes]

RECORD = struct.Struct("<BQ")
MESSAGE_FIELDS = struct.Struct("<IQQ")
"""What precedes a message's data behind its channel id: sequence, log time, publish time."""
_MESSAGE = int(Opcode.MESSAGE)
_MESSAGE_START = struct.Struct("<BQH")
_MESSAGE_PREFIX = RECORD.size + 2
_MESSAGE_MIN = 2 + MESSAGE_FIELDS.size
_FOOTER_SIZE = 20
_CHUNK_START = 44  # how much of a chunk's body shows whether it is one [bytes]
# Where reading may start again: a chunk or a metadata record below 4 GiB, or the end of the data.
_RESTART = re.compile(rb"(?=[\x06\x0c].{4}\x00{4}|\x0f\x04\x00{7})", re.DOTALL)
_RESTART_SIZE = 9
_MAX_RESTARTS = 100_000
_WINDOW = 1 << 20
_MAX_METADATA = 1 << 20

T = TypeVar("T")


class DamageError(Exception):
    """A record that is not what it claims to be."""


@dataclass(frozen=True, slots=True)
class Span:
    """A run of the file: a chunk (``chunk``), or records that stand by themselves."""

    offset: int
    size: int
    chunk: bool = False


@dataclass(slots=True)
class TopicInfo:
    """A channel's messages: how many, first and last log time [UNIX ns]; its name and type."""

    count: int = 0
    first_ns: int = 1 << 64
    last_ns: int = 0
    name: str = ""
    type_name: str = ""

    @property
    def rate_hz(self) -> float:
        """Mean rate [Hz]; 0 for fewer than two messages."""
        span_ns = self.last_ns - self.first_ns
        return (self.count - 1) * 1e9 / span_ns if self.count > 1 and span_ns > 0 else 0.0


_NO_SCHEMA = rec.Schema(id=0, data=b"", encoding="", name="")


@dataclass
class SessionInfo:
    """What a session holds, as one pass over its file found it."""

    path: Path
    size: int  # of the file [bytes]
    spans: list[Span] = field(default_factory=list)
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    counts: dict[int, TopicInfo] = field(default_factory=dict)  # of channels with messages
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attached: list[tuple[str, Span]] = field(default_factory=list)  # where each record's body lies
    # What is wrong with it but does not prevent reading the rest, a line each
    warnings: list[str] = field(default_factory=list)
    lost: int = 0  # how much could not be read [bytes]
    profile: str = ""
    finished: bool = False  # the container's end is whole

    def schema(self, channel: rec.Channel) -> rec.Schema:
        """A channel's schema; one without a name where there is none."""
        return self.schemas.get(channel.schema_id, _NO_SCHEMA)

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Its channels, by name and type."""
        found = []
        for key, channel in sorted(self.channels.items()):
            seen, kind = self.counts.get(key, TopicInfo(0, 0)), self.schema(channel).name
            found.append(replace(seen, name=channel.topic, type_name=kind))
        return tuple(found)

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the attached files."""
        return tuple(name for name, _ in self.attached)

    @property
    def clean(self) -> bool:
        """Whether the recorder also said why it ended (``steerd.end``); if not, it crashed."""
        return self.finished and "steerd.end" in self.metadata

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(each.count for each in self.counts.values())

    @property
    def start_ns(self) -> int:
        """Time of the first message [UNIX ns]; 0 without one."""
        return min((each.first_ns for each in self.counts.values()), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last message [UNIX ns]; 0 without one."""
        return max((each.last_ns for each in self.counts.values()), default=0)

    @property
    def duration_s(self) -> float:
        """First to last message [s]."""
        return (self.end_ns - self.start_ns) * 1e-9


def read_contents(path: Path, file: int, size: int) -> SessionInfo:
    """Read and check the first ``size`` bytes of a container; never raises on damage.

    The caller has checked the magic. The position in ``file``, a descriptor, does not matter.

    Raises:
        OSError: if the file cannot be read.
    """
    contents = SessionInfo(path, size)
    _walk(contents, file, size)
    for channel in sorted(contents.counts.keys() - contents.channels.keys()):
        count = contents.counts.pop(channel).count
        contents.warnings.append(f"{count} messages of channel {channel}, which is defined nowhere")
    return contents


def _walk(contents: SessionInfo, file: int, size: int) -> None:
    """Go from record to record, behind damage too, up to the end of the file."""
    crc, pos, intact = zlib.crc32(MAGIC), len(MAGIC), True
    while True:
        try:
            opcode, body = _read_record(file, pos, size)
            if opcode == Opcode.DATA_END:
                break
            _take(contents, opcode, body, pos)
        except DamageError as damage:
            intact, found = False, _resync(file, pos, size)
            contents.lost += (found or size) - pos
            if found is None:
                text = f"not finished, {damage} at byte {pos}; {size - pos} bytes lost"
                contents.warnings.append(text)
                return
            contents.warnings.append(f"damaged at byte {pos} ({damage}), reading on at {found}")
            pos = found
            continue
        if intact:
            crc = zlib.crc32(body, zlib.crc32(RECORD.pack(opcode, len(body)), crc))
        pos += RECORD.size + len(body)
    if intact and parse(rec.DataEnd, body).data_section_crc not in (0, crc):
        contents.warnings.append("data section fails its CRC")
    _take_summary(contents, file, pos + RECORD.size + len(body), size)


def read_span(file: int, span: Span) -> bytes:
    """A span's records, decompressed and checked; DamageError if the file has changed."""
    raw = os.pread(file, span.size, span.offset)
    if len(raw) != span.size:
        raise DamageError("the file has become shorter")
    return open_chunk(raw[RECORD.size :]) if span.chunk else raw


def scan_messages(data: bytes) -> tuple[dict[int, list[tuple[int, int]]], list[tuple[int, bytes]]]:
    """Find the messages of a run of records, by channel id, and the others' (opcode, body).

    A message is the (start, end) of what stands behind its channel id. The library makes an object
    of each, in five times the time of the whole reading.

    Raises:
        DamageError: if lengths do not add up.
    """
    found: dict[int, list[tuple[int, int]]] = defaultdict(list)
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
        if opcode != _MESSAGE:
            others.append((opcode, data[start + 9 : pos]))
        elif length < _MESSAGE_MIN:
            raise DamageError("a message is cut")
        else:
            found[channel].append((start + _MESSAGE_PREFIX, pos))
    return found, others


# -- records -------------------------------------------------------------------------------------


class _Body(io.BytesIO):
    """A record's body as the library reads it; a field never leaves it."""

    def read(self, size: int) -> bytes:  # type: ignore[override]
        data = super().read(min(size, MAX_RECORD))
        if len(data) < size:
            raise DamageError("a record's fields do not fit it")
        return data


def parse(kind: type[T], body: bytes) -> T:
    """A record of the library from its body; DamageError if its fields are not its body."""
    fields = _Body(body)
    try:
        record: T = cast("Any", kind).read(ReadDataStream(fields))
    except UnicodeDecodeError as error:
        raise DamageError("a name is not UTF-8") from error
    if fields.tell() != len(body):
        raise DamageError("a record is longer than its fields")
    return record


def open_chunk(body: bytes) -> bytes:
    """Decompress a chunk's records within the caps and check its CRC.

    The library unpacks what a frame says of itself, whatever the chunk says.

    Raises:
        DamageError: on a wrong size or CRC, a compression that is unknown or fails, or a ratio
            above ``MAX_RATIO`` (a bomb).
    """
    chunk = parse(rec.Chunk, body)
    size, packed = chunk.uncompressed_size, chunk.data
    if size > MAX_RECORD or (size > FREE_SIZE and size > MAX_RATIO * len(packed)):
        raise DamageError(f"{len(packed)} bytes claim to unpack to {size}")
    try:
        match chunk.compression:
            case "":
                data = packed
            case "zstd":
                if zstandard.frame_content_size(packed) > size:
                    raise DamageError("the chunk's size is a lie")
                data = zstandard.decompress(packed, size)
            case "lz4":  # its frames need not say how much they hold
                data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
            case other:
                raise DamageError(f"unknown compression {other!r}")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamageError(f"does not decompress ({error})") from error
    if len(data) != size:
        raise DamageError("wrong decompressed size")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise DamageError("CRC mismatch")
    return data


def _read_record(file: int, pos: int, size: int) -> tuple[int, bytes]:
    head = os.pread(file, RECORD.size, pos)
    if len(head) < RECORD.size or pos + RECORD.size > size:
        raise DamageError("the file ends without its end record")
    opcode, length = RECORD.unpack(head)
    if opcode == 0:
        raise DamageError("zeros where a record should be")
    if length > MAX_RECORD:
        raise DamageError(f"a record claims {length} bytes")
    if pos + RECORD.size + length > size:
        raise DamageError("the file ends inside a record")
    if opcode == Opcode.DATA_END and length != 4:
        raise DamageError("bad end record")
    body = os.pread(file, length, pos + RECORD.size)
    if len(body) != length:
        raise DamageError("the file has become shorter")
    return opcode, body


def _take(contents: SessionInfo, opcode: int, body: bytes, pos: int) -> None:
    match opcode:
        case Opcode.CHUNK:
            _take_chunk(contents, body, pos)
        case Opcode.MESSAGE_INDEX:
            # Nothing here uses the index, but a flipped opcode must not hide a chunk behind it.
            if len(body) < 6 or struct.unpack_from("<I", body, 2)[0] != len(body) - 6:
                raise DamageError("bad message index")
        case Opcode.SCHEMA | Opcode.CHANNEL | Opcode.MESSAGE:
            data = RECORD.pack(opcode, len(body)) + body
            _take_records(contents, data)
            _add_plain_span(contents.spans, Span(pos, len(data)))
        case Opcode.ATTACHMENT:
            name = parse(rec.Attachment, body).name
            if body[-4:] not in (bytes(4), struct.pack("<I", zlib.crc32(body[:-4]))):
                raise DamageError(f"attachment {name!r} fails its CRC")
            contents.attached.append((name, Span(pos + RECORD.size, len(body))))
        case Opcode.METADATA:
            metadata = parse(rec.Metadata, body)
            contents.metadata[metadata.name] = metadata.metadata
        case Opcode.HEADER:
            contents.profile = parse(rec.Header, body).profile
        case _ if opcode <= Opcode.DATA_END:
            raise DamageError("a summary record inside the data")
        case _:
            contents.warnings.append(f"record of unknown kind {opcode:#x} skipped")
            contents.lost += len(body)


def _add_plain_span(spans: list[Span], new: Span) -> None:
    last = spans[-1] if spans else None
    if last and not last.chunk and last.offset + last.size == new.offset and last.size < _WINDOW:
        spans[-1] = Span(last.offset, last.size + new.size)
    else:
        spans.append(new)


def _take_chunk(contents: SessionInfo, body: bytes, pos: int) -> None:
    try:
        _take_records(contents, open_chunk(body))
    except DamageError as damage:
        if not _frames_chunk(body, len(body)):
            raise  # its length is not to be believed either
        contents.warnings.append(f"chunk at byte {pos} skipped: {damage}")
        contents.lost += len(body)
        return
    contents.spans.append(Span(pos, RECORD.size + len(body), chunk=True))


def _take_records(contents: SessionInfo, data: bytes) -> None:
    messages, others = scan_messages(data)
    for opcode, body in others:
        _define(contents, opcode, body)
    for channel, places in messages.items():
        count = contents.counts.setdefault(channel, TopicInfo())
        count.count += len(places)
        for start, _ in (places[0], places[-1]):
            log_ns = MESSAGE_FIELDS.unpack_from(data, start)[1]
            count.first_ns = min(count.first_ns, log_ns)
            count.last_ns = max(count.last_ns, log_ns)


def _define(contents: SessionInfo, opcode: int, body: bytes) -> None:
    if opcode == Opcode.SCHEMA:
        schema = parse(rec.Schema, body)
        _set_once(contents, contents.schemas, schema.id, schema)
    elif opcode == Opcode.CHANNEL:
        channel = parse(rec.Channel, body)
        if len(contents.channels) >= MAX_CHANNELS and channel.id not in contents.channels:
            raise DamageError(f"more than {MAX_CHANNELS} channels")
        _set_once(contents, contents.channels, channel.id, channel)


def _set_once(contents: SessionInfo, known: dict[int, T], key: int, value: T) -> None:
    if known.setdefault(key, value) != value:
        text = f"{type(value).__name__.lower()} {key} is defined twice, differently: first kept"
        contents.warnings.append(text)


# -- damage --------------------------------------------------------------------------------------


def _resync(file: int, pos: int, size: int) -> int | None:
    """Find the next offset behind ``pos`` at which a believable record starts."""
    tried, at = 0, pos + 1
    limit = min(size, pos + MAX_RESYNC)
    while at < limit and tried < _MAX_RESTARTS:
        window = os.pread(file, _WINDOW, at)
        for match in _RESTART.finditer(window):
            tried += 1
            if _believable(file, at + match.start(), size):
                return at + match.start()
        at += max(1, len(window) - _RESTART_SIZE + 1)
    return None


def _believable(file: int, pos: int, size: int) -> bool:
    opcode, length = RECORD.unpack(os.pread(file, RECORD.size, pos))
    if length > min(MAX_RECORD, size - pos - RECORD.size):
        return False
    if opcode == Opcode.CHUNK:
        return _frames_chunk(os.pread(file, _CHUNK_START, pos + RECORD.size), length)
    if opcode == Opcode.METADATA and length <= _MAX_METADATA:
        try:
            parse(rec.Metadata, os.pread(file, length, pos + RECORD.size))
        except DamageError:
            return False
    return opcode == Opcode.DATA_END or bool(length <= _MAX_METADATA)


def _frames_chunk(start: bytes, length: int) -> bool:
    """Whether a body of ``length`` bytes that begins with ``start`` has the parts of a chunk."""
    name = int.from_bytes(start[28:32], "little")
    if len(start) < 40 + name or start[32 : 32 + name] not in (b"", b"zstd", b"lz4"):
        return False
    return 40 + name + int.from_bytes(start[32 + name : 40 + name], "little") == length


# -- the end of the file -------------------------------------------------------------------------


def _take_summary(contents: SessionInfo, file: int, pos: int, size: int) -> None:
    """Accept the file as finished if its end is whole; learn schemas that a lost chunk held."""
    tail = os.pread(file, min(size - pos, MAX_RECORD), pos)
    footer = len(tail) - len(MAGIC) - _FOOTER_SIZE
    start = footer - RECORD.size
    crc = footer + _FOOTER_SIZE - 4
    contents.finished = (
        start >= 0
        and tail.endswith(MAGIC)
        and tail[start:footer] == RECORD.pack(Opcode.FOOTER, _FOOTER_SIZE)
        and int.from_bytes(tail[crc : crc + 4], "little") in (0, zlib.crc32(tail[:crc]))
    )
    if not contents.finished:
        contents.warnings.append("not finished: the summary at its end is missing or damaged")
        return
    try:
        for opcode, body in scan_messages(tail[:start])[1]:
            _define(contents, opcode, body)
    except DamageError as damage:
        contents.warnings.append(f"summary: {damage}")
