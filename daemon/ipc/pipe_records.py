"""Messages from the control core to recorder, gateway and viewer: records on a pipe.

Messages are values: counted per topic, encoded once and given to every sink at `Outbox.flush`,
after the tick's bytes were written. The core never waits: the pipe is non-blocking, a record is
written whole or dropped and counted. The learner's reports come the same way.
"""

import contextlib
import fcntl
import os
import select
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.quick_values import quick_value
from steerd.steer_bus.topics import TOPICS, Topic

PIPE_BYTES = 1 << 20  # about 4 s at 200 Hz (`docs/reference/safety-requirements.md#s2.3`)
_HEAD = struct.Struct("<IHHIqq")
_F_SETPIPE_SZ = 1031
_JOINED_NS = 100_000_000  # holes closer to each other are one
_INDEX = {topic.name: index for index, topic in enumerate(TOPICS)}


@quick_value
class PipeRecord:
    """One encoded outgoing message of the core."""

    topic: Topic
    sequence: int  # counter per topic
    log_time_ns: int  # UNIX time at which the core sent it
    publish_time_ns: int  # UNIX time of the sample itself
    data: bytes  # CDR
    # What was encoded, for readers in the core's own process; None behind a pipe
    message: Any = None


def read_message(record: PipeRecord) -> Any:
    """The message of a record, decoded where it crossed a pipe."""
    known = record.message
    return decode(record.topic.message, record.data) if known is None else known


Sink = Callable[[list[PipeRecord], int], None]
"""Takes the records of one tick and the monotonic time [ns]; must not block."""
_Queued = tuple[Topic, int, int, int, Any]
"""A `PipeRecord` to be: its topic, number, two times and message."""


@dataclass(slots=True)
class Outbox:
    """Messages of the current tick."""

    epoch_ns: int  # UNIX time minus monotonic time, fixed for the session [ns]
    sinks: tuple[Sink, ...]  # receivers of the records at `flush`
    _pending: list[_Queued] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)
    _last_ns: int = 0

    def post(self, topic: Topic, message: Any, t_ns: int, valid_ns: int | None = None) -> None:
        """Queue a message of time `t_ns` whose content is valid at `valid_ns` (monotonic)."""
        if not self.sinks:
            return
        name = topic.name
        count = self._counts.get(name, 0)
        self._counts[name] = count + 1
        # A session file is in the order of the loop: log times never go back (mcap doctor warns).
        if t_ns > self._last_ns:
            self._last_ns = t_ns
        publish_ns = (t_ns if valid_ns is None else valid_ns) + self.epoch_ns
        self._pending.append((topic, count, self._last_ns + self.epoch_ns, publish_ns, message))

    def flush(self, t_ns: int) -> None:
        """Encode everything queued and give it to the sinks.

        Raises:
            CodecError: a message cannot be encoded; it alone is lost.
        """
        if not self._pending:
            return
        queued, self._pending = self._pending, []
        records, wrong = [], None
        for topic, count, log_ns, publish_ns, message in queued:
            try:
                data = encode(message)
            except CodecError as error:
                wrong = wrong or error
            else:
                records.append(PipeRecord(topic, count, log_ns, publish_ns, data, message))
        for sink in self.sinks:
            sink(records, t_ns)
        if wrong is not None:
            raise wrong


def pack_record(record: PipeRecord) -> bytes:
    """The record as pipe bytes."""
    head = _HEAD.pack(
        len(record.data),
        _INDEX[record.topic.name],
        0,
        record.sequence & 0xFFFFFFFF,
        record.log_time_ns,
        record.publish_time_ns,
    )
    return head + record.data


def unpack_records(buffer: bytearray) -> Iterator[PipeRecord]:
    """Remove every whole record from the front of `buffer`."""
    start = 0
    while len(buffer) - start >= _HEAD.size:
        size, index, _, sequence, log_ns, publish_ns = _HEAD.unpack_from(buffer, start)
        end = start + _HEAD.size + size
        if len(buffer) < end:
            break
        data = bytes(buffer[start + _HEAD.size : end])
        start = end
        yield PipeRecord(TOPICS[index], sequence, log_ns, publish_ns, data)
    del buffer[:start]


def make_pipe() -> tuple[int, int]:
    """A pipe (read end, write end); the write end is non-blocking and has room for seconds."""
    read_fd, write_fd = os.pipe()
    os.set_blocking(write_fd, False)
    with contextlib.suppress(PermissionError):  # quota spent: the default 64 KiB counts too
        fcntl.fcntl(write_fd, _F_SETPIPE_SZ, PIPE_BYTES)
    return read_fd, write_fd


@dataclass(slots=True)
class PipeWriter:
    """The core's end of one pipe."""

    fd: int  # non-blocking write end
    dropped: int = 0  # records lost to a full or dead pipe
    dead: bool = False  # whether the reader is gone
    full_since_ns: int | None = None  # since when it has taken nothing that was offered, or None
    _rest: bytes = b""

    def write(self, packed: list[bytes], t_ns: int) -> None:
        """Write these records or drop them all; never waits, never raises.

        The pipe may take a batch in part; the rest is written first next time, so that no record
        is torn.
        """
        if self._rest:
            self._rest = self._push(self._rest, t_ns)
        batch = b"".join(packed)
        if not batch:
            return
        left = batch if self._rest or self.dead else self._push(batch, t_ns)
        if len(left) == len(batch):
            self.dropped += len(packed)
        else:
            self._rest = left

    def _push(self, data: bytes, t_ns: int) -> bytes:
        """What the pipe did not take; it is full from the first refusal until it takes a byte."""
        taken = 0
        try:
            taken = os.write(self.fd, data)
        except BlockingIOError:
            self.full_since_ns = t_ns if self.full_since_ns is None else self.full_since_ns
        except OSError:
            self.dead = True
        if taken:
            self.full_since_ns = None
        return data[taken:]


@dataclass
class Gaps:
    """Records that were dropped on the way, by their numbers."""

    missed: int = 0  # how many so far
    _spans: list[tuple[int, int]] = field(default_factory=list)
    _last: dict[str, tuple[int, int]] = field(default_factory=dict)

    def take(self, record: PipeRecord) -> None:
        """Count what is missing before a record; the first of a topic misses nothing."""
        log_ns = record.log_time_ns
        number, before_ns = self._last.get(record.topic.name, (record.sequence - 1, log_ns))
        self._last[record.topic.name] = record.sequence, log_ns
        if record.sequence > number + 1:
            self.missed += record.sequence - number - 1
            self.add(before_ns, log_ns)

    def add(self, first_ns: int, last_ns: int) -> None:
        """Take in a stretch with missing records; of one that several topics name, the common part.

        A pipe loses whole ticks, so a frequent topic shows where more precisely than a rare one.
        """
        if self._spans and self._spans[-1][1] > first_ns:
            other = self._spans.pop()
            first_ns, last_ns = max(first_ns, other[0]), min(last_ns, other[1])
        self._spans.append((first_ns, last_ns))

    @property
    def spans(self) -> list[tuple[int, int]]:
        """Stretches with missing records [UNIX ns], those that nearly touch as one."""
        joined: list[tuple[int, int]] = []
        for first, last in self._spans:
            if joined and first - joined[-1][1] < _JOINED_NS:
                first = joined.pop()[0]
            joined.append((first, last))
        return joined


LEARNT_FROM = (topics.MOCAP, topics.ACTUATION, topics.VESC)  # a drive is learnt from
_WANTED = frozenset(topic.name for topic in (*LEARNT_FROM, topics.DESIGN))


def is_learnt_from(record: PipeRecord) -> bool:
    """Whether the learner wants a record: of the drive, or what became of its proposals."""
    return record.topic.name in _WANTED


_READ_BYTES = 1 << 20


@dataclass
class PipeReader:
    """One reader's end; without a writer, and once that has ended, it gives nothing."""

    fd: int | None  # to read from; None without a writer, and once it has ended
    _buffer: bytearray = field(default_factory=bytearray)

    def __post_init__(self) -> None:
        self._poll = select.poll()
        if self.fd is not None:
            os.set_blocking(self.fd, False)
            self._poll.register(self.fd, select.POLLIN | select.POLLHUP)

    def wait(self, ms: int | None = None) -> bool:
        """Wait for so long at most; whether records have come, or the end."""
        return self.fd is not None and bool(self._poll.poll(ms))

    def take(self) -> Iterator[PipeRecord]:
        """Records that have come."""
        while self.fd is not None:
            try:
                data = os.read(self.fd, _READ_BYTES)
            except BlockingIOError:
                break
            if not data:
                self.close()
            self._buffer += data
            yield from unpack_records(self._buffer)

    def close(self) -> None:
        """Take no more: the writer sees it."""
        if self.fd is not None:
            self._poll.unregister(self.fd)
            os.close(self.fd)
            self.fd = None

    def rest(self, wait_ms: int) -> Iterator[PipeRecord]:
        """Records until the writer has ended, or sends none for so long."""
        while self.wait(wait_ms):
            yield from self.take()
