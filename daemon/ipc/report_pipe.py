"""The learner's reports where they are read: taken when there are some, never waited for."""

import os
import select
from collections.abc import Iterator
from dataclasses import dataclass, field

from steerd.daemon.ipc.pipe_records import PipeRecord, unpack_records

_READ_BYTES = 1 << 16


@dataclass
class ReportPipe:
    """One reader's end."""

    fd: int | None  # to read from; None without a learner, and once it has ended
    _buffer: bytearray = field(default_factory=bytearray)

    def __post_init__(self) -> None:
        if self.fd is not None:
            os.set_blocking(self.fd, False)

    def take(self) -> Iterator[PipeRecord]:
        """Reports that have come."""
        while self.fd is not None:
            try:
                data = os.read(self.fd, _READ_BYTES)
            except BlockingIOError:
                break
            if not data:
                os.close(self.fd)
                self.fd = None
            self._buffer += data
        yield from unpack_records(self._buffer)

    def rest(self, wait_ms: int) -> Iterator[PipeRecord]:
        """Reports until the learner has ended, or sends none for so long."""
        poll = select.poll()
        if self.fd is not None:
            poll.register(self.fd, select.POLLIN | select.POLLHUP)
        while self.fd is not None and poll.poll(wait_ms):
            yield from self.take()
