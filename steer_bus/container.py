"""The MCAP container as it may really be found: unfinished, damaged, foreign or hostile.

One sequential pass (:func:`read_contents`) checks every CRC, refuses lengths beyond its caps,
skips damaged records to the next one that makes sense, and says what it skipped. It holds one
record at a time, so memory is bounded by the caps whatever the file claims.

Source: the MCAP specification (mcap.dev/spec), opcodes and field orders.
"""

import re
import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO, TypeVar

from steerd.steer_bus import mcap_records as rec
from steerd.steer_bus.mcap_records import DamageError, Fields

MAX_CHANNELS = 4096
MAX_RESYNC = 64 << 20
"""How far behind damage the next good record is looked for [bytes]."""

# Where reading may start again: a chunk or a metadata record below 4 GiB, or the end of the data.
_RESTART = re.compile(rb"(?=[\x06\x0c].{4}\x00{4}|\x0f\x04\x00{7})", re.DOTALL)
_RESTART_SIZE = 9
_MAX_RESTARTS = 100_000
_WINDOW = 1 << 20
_MAX_METADATA = 1 << 20


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class SessionWarning:
    """Something wrong with a file that does not prevent reading the rest.

    Attributes:
        code: ``unfinished``, ``damaged``, ``unknown_record``, ``unknown_channel`` or ``conflict``.
        message: one line for people.
        offset: where in the file [bytes].
        lost: how much could not be read [bytes].
    """

    code: str
    message: str
    offset: int
    lost: int = 0


@dataclass(frozen=True, slots=True)
class Span:
    """A checked run of records: a chunk (``chunk``), or one record that stands by itself."""

    offset: int
    size: int
    chunk: bool


@dataclass(slots=True)
class ChannelCount:
    """How many messages a channel has, and its first and last log time [ns]."""

    count: int = 0
    first_ns: int = 1 << 64
    last_ns: int = 0


@dataclass(slots=True)
class Contents:
    """What one pass found in a file."""

    spans: list[Span] = field(default_factory=list)
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    counts: dict[int, ChannelCount] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[rec.Attachment] = field(default_factory=list)
    warnings: list[SessionWarning] = field(default_factory=list)
    profile: str = ""
    library: str = ""
    finished: bool = False


def read_contents(file: BinaryIO, size: int) -> Contents:
    """Read and check a whole container of ``size`` bytes; never raises on damage.

    The caller has checked the magic. Bytes that a writer appends meanwhile are not looked at.

    Raises:
        OSError: if the file cannot be read.
    """
    contents = Contents()
    file.seek(0)
    crc = zlib.crc32(file.read(len(rec.MAGIC)))
    pos, intact = len(rec.MAGIC), True
    while True:
        try:
            opcode, body = _read_record(file, pos, size)
            if opcode == rec.DATA_END:
                break
            _take(contents, opcode, body, pos)
        except DamageError as damage:
            intact = False
            found = _resync(file, pos, size)
            _note_loss(contents, str(damage), pos, found, size)
            if found is None:
                _note_orphans(contents)
                return contents
            pos = found
            continue
        if intact:
            crc = zlib.crc32(body, zlib.crc32(rec.RECORD.pack(opcode, len(body)), crc))
        pos += rec.RECORD.size + len(body)
    (expected,) = struct.unpack("<I", body)
    if intact and expected not in (0, crc):
        contents.warnings.append(SessionWarning("damaged", "data section fails its CRC", 0))
    _take_summary(contents, file, pos + rec.RECORD.size + len(body), size)
    _note_orphans(contents)
    return contents


def read_span(file: BinaryIO, span: Span) -> bytes:
    """Read a span's records again, decompressed and checked.

    Raises:
        DamageError: if the file has changed since it was opened.
    """
    file.seek(span.offset)
    raw = file.read(span.size)
    if len(raw) != span.size:
        raise DamageError("the file has become shorter")
    return rec.open_chunk(raw[rec.RECORD.size :]) if span.chunk else raw


# -- records -------------------------------------------------------------------------------------


def _read_record(file: BinaryIO, pos: int, size: int) -> tuple[int, bytes]:
    file.seek(pos)
    head = file.read(rec.RECORD.size)
    if len(head) < rec.RECORD.size or pos + rec.RECORD.size > size:
        raise DamageError("the file ends without its end record")
    opcode, length = rec.RECORD.unpack(head)
    if opcode == 0:
        raise DamageError("zeros where a record should be")
    if length > rec.MAX_RECORD:
        raise DamageError(f"a record claims {length} bytes")
    if pos + rec.RECORD.size + length > size:
        raise DamageError("the file ends inside a record")
    if opcode == rec.DATA_END and length != 4:
        raise DamageError("bad end record")
    body = file.read(length)
    if len(body) != length:
        raise DamageError("the file has become shorter")
    return opcode, body


def _take(contents: Contents, opcode: int, body: bytes, pos: int) -> None:
    if opcode == rec.CHUNK:
        _take_chunk(contents, body, pos)
    elif opcode in (rec.SCHEMA, rec.CHANNEL, rec.MESSAGE):
        data = rec.RECORD.pack(opcode, len(body)) + body
        _take_records(contents, data)
        _add_plain_span(contents.spans, Span(pos, len(data), chunk=False))
    elif opcode == rec.ATTACHMENT:
        contents.attachments.append(rec.read_attachment(body, pos))
    elif opcode in (rec.METADATA, rec.HEADER):
        _take_text(contents, opcode, Fields(body))
    elif opcode == rec.INDEX:
        rec.check_index(body)
    elif opcode <= rec.LAST_OPCODE:
        raise DamageError("a summary record inside the data")
    else:
        text = f"record of unknown kind {opcode:#x} skipped"
        contents.warnings.append(SessionWarning("unknown_record", text, pos, len(body)))


def _take_text(contents: Contents, opcode: int, fields: Fields) -> None:
    if opcode == rec.METADATA:
        name = fields.text()
        contents.metadata[name] = fields.text_map()
    else:
        contents.profile, contents.library = fields.text(), fields.text()
    fields.end()


def _add_plain_span(spans: list[Span], new: Span) -> None:
    last = spans[-1] if spans else None
    if last and not last.chunk and last.offset + last.size == new.offset and last.size < _WINDOW:
        spans[-1] = Span(last.offset, last.size + new.size, chunk=False)
    else:
        spans.append(new)


def _take_chunk(contents: Contents, body: bytes, pos: int) -> None:
    try:
        _take_records(contents, rec.open_chunk(body))
    except DamageError as damage:
        if not rec.plausible_chunk(body[: rec.CHUNK_START_SIZE], len(body)):
            raise  # its length is not to be believed either
        contents.warnings.append(
            SessionWarning("damaged", f"chunk at byte {pos} skipped: {damage}", pos, len(body))
        )
        return
    contents.spans.append(Span(pos, rec.RECORD.size + len(body), chunk=True))


def _take_records(contents: Contents, data: bytes) -> None:
    messages, others = rec.scan_messages(data)
    for opcode, body in others:
        _define(contents, opcode, body)
    for channel, places in messages.items():
        count = contents.counts.setdefault(channel, ChannelCount())
        count.count += len(places)
        for start, _ in (places[0], places[-1]):
            log_ns = rec.MESSAGE_FIELDS.unpack_from(data, start)[1]
            count.first_ns = min(count.first_ns, log_ns)
            count.last_ns = max(count.last_ns, log_ns)


def _define(contents: Contents, opcode: int, body: bytes) -> None:
    fields = Fields(body)
    if opcode == rec.SCHEMA:
        key = fields.number("<H")
        schema = rec.Schema(fields.text(), fields.text(), fields.raw())
        _set_once(contents, contents.schemas, key, schema)
    elif opcode == rec.CHANNEL:
        key, schema_id = fields.number("<H"), fields.number("<H")
        channel = rec.Channel(fields.text(), fields.text(), schema_id, fields.text_map())
        if len(contents.channels) >= MAX_CHANNELS and key not in contents.channels:
            raise DamageError(f"more than {MAX_CHANNELS} channels")
        _set_once(contents, contents.channels, key, channel)


def _set_once(contents: Contents, known: dict[int, T], key: int, value: T) -> None:
    if known.setdefault(key, value) != value:
        text = f"{type(value).__name__.lower()} {key} is defined twice, differently: first kept"
        contents.warnings.append(SessionWarning("conflict", text, 0))


# -- damage --------------------------------------------------------------------------------------


def _note_loss(contents: Contents, why: str, pos: int, found: int | None, size: int) -> None:
    if found is None:
        text = f"not finished, {why} at byte {pos}; {size - pos} bytes lost"
        contents.warnings.append(SessionWarning("unfinished", text, pos, size - pos))
    else:
        text = f"damaged at byte {pos} ({why}), reading on at {found}"
        contents.warnings.append(SessionWarning("damaged", text, pos, found - pos))


def _resync(file: BinaryIO, pos: int, size: int) -> int | None:
    """Find the next offset behind ``pos`` at which a believable record starts."""
    tried, at = 0, pos + 1
    limit = min(size, pos + MAX_RESYNC)
    while at < limit and tried < _MAX_RESTARTS:
        file.seek(at)
        window = file.read(_WINDOW)
        for match in _RESTART.finditer(window):
            tried += 1
            if _believable(file, at + match.start(), size):
                return at + match.start()
        at += max(1, len(window) - _RESTART_SIZE + 1)
    return None


def _believable(file: BinaryIO, pos: int, size: int) -> bool:
    file.seek(pos)
    opcode: int
    length: int
    opcode, length = rec.RECORD.unpack(file.read(rec.RECORD.size))
    if length > min(rec.MAX_RECORD, size - pos - rec.RECORD.size):
        return False
    if opcode == rec.CHUNK:
        return rec.plausible_chunk(file.read(rec.CHUNK_START_SIZE), length)
    if opcode == rec.METADATA and length <= _MAX_METADATA:
        try:
            _take_text(Contents(), rec.METADATA, Fields(file.read(length)))
        except DamageError:
            return False
    return opcode == rec.DATA_END or length <= _MAX_METADATA


# -- the end of the file -------------------------------------------------------------------------


def _take_summary(contents: Contents, file: BinaryIO, pos: int, size: int) -> None:
    """Accept the file as finished if its end is whole; learn schemas that a lost chunk held."""
    file.seek(pos)
    tail = file.read(min(size - pos, rec.MAX_RECORD))
    footer = len(tail) - len(rec.MAGIC) - rec.FOOTER_FIELDS.size
    start = footer - rec.RECORD.size
    contents.finished = (
        start >= 0
        and tail.endswith(rec.MAGIC)
        and tail[start:footer] == rec.RECORD.pack(rec.FOOTER, rec.FOOTER_FIELDS.size)
        and rec.FOOTER_FIELDS.unpack_from(tail, footer)[2]
        in (0, zlib.crc32(tail[: footer + rec.FOOTER_FIELDS.size - 4]))
    )
    if not contents.finished:
        text = "not finished: the summary at its end is missing or damaged"
        contents.warnings.append(SessionWarning("unfinished", text, pos))
        return
    try:
        for opcode, body in rec.scan_messages(tail[:start])[1]:
            _define(contents, opcode, body)
    except DamageError as damage:
        contents.warnings.append(SessionWarning("damaged", f"summary: {damage}", pos))


def _note_orphans(contents: Contents) -> None:
    for channel in sorted(contents.counts.keys() - contents.channels.keys()):
        count = contents.counts.pop(channel).count
        text = f"{count} messages of channel {channel}, which is defined nowhere"
        contents.warnings.append(SessionWarning("unknown_channel", text, 0))
