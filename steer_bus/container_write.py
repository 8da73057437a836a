"""The mcap library's writer of files, with little memory.

It keeps an index of each chunk, 12 MiB an hour at four chunks a second. Foreign readers find
messages by these alone, so none can be left out: here they are kept compressed, as they will stand
in the summary, 1 MiB an hour.
"""

import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO

from mcap.data_stream import RecordBuilder  # noqa: TID251
from mcap.records import ChunkIndex  # noqa: TID251
from mcap.writer import Writer  # noqa: TID251


class ContainerWriter(Writer):
    """Writes one new file, which its giver closes; raises OSError where the disk takes no more.

    ``profile`` is whose conventions the file follows.
    """

    def __init__(self, file: BinaryIO, profile: str) -> None:
        super().__init__(file, enable_data_crcs=True)
        self._Writer__chunk_indices = _PackedIndexes()  # the library's own name; a test holds it
        self.start(profile, "steerd")


class _PackedIndexes(list[ChunkIndex]):
    """Indexes of chunks, as the library adds them and writes them at the end."""

    def __init__(self) -> None:
        self._packed, self._compressor = bytearray(), zlib.compressobj()

    def append(self, index: ChunkIndex) -> None:
        builder = RecordBuilder()
        index.write(builder)
        self._packed += self._compressor.compress(builder.end())

    def __iter__(self) -> Iterator[Any]:
        yield self  # all of them at once

    def write(self, builder: RecordBuilder) -> None:
        builder.write(zlib.decompress(self._packed + self._compressor.flush()))
