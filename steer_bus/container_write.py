"""An MCAP file as the mcap library's writer writes it, byte by byte, with little memory.

The library's writer keeps an index of each chunk, 12 MiB an hour at four chunks a second. Foreign
readers find messages by these alone, so none can be left out: here they are kept compressed, as
they will stand in the summary, 1 MiB an hour.
"""

import zlib
from collections.abc import Mapping
from typing import BinaryIO

import zstandard
from mcap import records as rec  # noqa: TID251
from mcap.data_stream import RecordBuilder  # noqa: TID251
from mcap.opcode import Opcode  # noqa: TID251

from steerd.steer_bus.container import MAGIC

CHUNK_BYTES = 1 << 20  # a chunk is closed once its records are longer [bytes]
_SUMMARY = (
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX,
)  # fmt: skip
"""What a summary holds, in the library's order."""


def _encode(record: rec.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


class ContainerWriter:
    """Writes one new file, which its giver closes; raises OSError where the disk takes no more.

    ``profile`` is whose conventions the file follows.
    """

    def __init__(self, file: BinaryIO, profile: str) -> None:
        self._file, self._place, self._crc = file, 0, 0
        self._chunk = RecordBuilder()
        self._index: dict[int, rec.MessageIndex] = {}
        self._summary = dict.fromkeys(_SUMMARY, b"")
        self._chunk_indexes, self._compressor = bytearray(), zlib.compressobj()
        self._counted = rec.Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)
        self._put(MAGIC + _encode(rec.Header(profile, "steerd")))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Define a schema; its number."""
        number = self._counted.schema_count = self._counted.schema_count + 1
        self._define(Opcode.SCHEMA, rec.Schema(number, data, encoding, name))
        return number

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Define a channel of a schema, 0 for none; its number."""
        number = self._counted.channel_count = self._counted.channel_count + 1
        self._define(Opcode.CHANNEL, rec.Channel(number, topic, encoding, dict(metadata), schema))
        return number

    def _define(self, opcode: Opcode, record: rec.McapRecord) -> None:
        data = _encode(record)
        self._summary[opcode] += data
        self._chunk.write(data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append texts."""
        place, data = self._place, _encode(rec.Metadata(name, dict(values)))
        self._counted.metadata_count += 1
        self._summary[Opcode.METADATA_INDEX] += _encode(rec.MetadataIndex(place, len(data), name))
        self._put(data)

    def add_attachment(self, a: rec.Attachment) -> None:
        """Append a file."""
        place, data = self._place, _encode(a)
        self._counted.attachment_count += 1
        index = rec.AttachmentIndex(
            place, len(data), a.log_time, a.create_time, len(a.data), a.name, a.media_type
        )
        self._summary[Opcode.ATTACHMENT_INDEX] += _encode(index)
        self._put(data)

    def add_message(
        self, channel: int, log_ns: int, data: bytes, publish_ns: int, sequence: int
    ) -> None:
        """Add a message to the open chunk."""
        if channel not in self._index:
            self._index[channel] = rec.MessageIndex(channel, [])
        self._index[channel].records.append((log_ns, self._chunk.count))
        rec.Message(channel, log_ns, data, publish_ns, sequence).write(self._chunk)
        if self._chunk.count > CHUNK_BYTES:
            self._close_chunk()

    def flush(self) -> None:
        """Close the open chunk, if it holds messages, and hand everything to the kernel."""
        self._close_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._close_chunk()
        self._put(_encode(rec.DataEnd(self._crc)))
        start, offsets, self._crc = self._place, b"", 0
        packed = self._chunk_indexes + self._compressor.flush()
        self._summary[Opcode.CHUNK_INDEX] = zlib.decompress(packed)
        self._summary[Opcode.STATISTICS] = _encode(self._counted)
        for opcode, group in self._summary.items():
            offsets += _encode(rec.SummaryOffset(opcode, self._place, len(group)))
            self._put(group)
        offsets_start = self._place
        self._put(offsets)
        footer = _encode(rec.Footer(start, offsets_start, 0))
        crc = zlib.crc32(footer[:-4], self._crc)
        self._put(_encode(rec.Footer(start, offsets_start, crc)) + MAGIC)

    def _put(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._file.write(data)
        self._place += len(data)

    def _close_chunk(self) -> None:
        """Write the open chunk with its message indexes, and keep its own index for the end."""
        if not self._index:
            return
        indexes, self._index = self._index, {}
        times = [log_ns for index in indexes.values() for log_ns, _ in index.records]
        first_ns, last_ns = min(times), max(times)
        self._count(indexes, first_ns, last_ns)
        records: bytes = self._chunk.end()  # type: ignore[no-untyped-call]
        packed = zstandard.compress(records)
        crc, place = zlib.crc32(records), self._place
        self._put(_encode(rec.Chunk("zstd", packed, last_ns, first_ns, crc, len(records))))
        index_place, places = self._place, {}
        for channel, index in indexes.items():
            places[channel] = self._place
            self._put(_encode(index))
        chunk_index = rec.ChunkIndex(
            index_place - place, place, "zstd", len(packed), last_ns, self._place - index_place,
            places, first_ns, len(records),
        )  # fmt: skip
        self._chunk_indexes += self._compressor.compress(_encode(chunk_index))

    def _count(self, indexes: Mapping[int, rec.MessageIndex], first_ns: int, last_ns: int) -> None:
        c, counts = self._counted, self._counted.channel_message_counts
        c.message_start_time = min(first_ns, c.message_start_time if counts else first_ns)
        c.message_end_time = max(last_ns, c.message_end_time)
        for channel, index in indexes.items():
            counts[channel] = counts.get(channel, 0) + len(index.records)
        c.message_count, c.chunk_count = sum(counts.values()), c.chunk_count + 1
