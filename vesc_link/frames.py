"""VESC framing: payload bytes to frames and back, with no I/O and no clock.

``start | length | payload | CRC-16/XMODEM (big-endian) | 0x03`` where the start byte is 0x02 with a
one-byte length or 0x03 with a two-byte length. Source: `docs/reference/vesc-serial.md#v1`.

One parser serves both ends. ``strict=True`` is the firmware's own receiver, head-of-line blocking
included (the simulated VESC uses it). ``strict=False`` is the host's: the same frames are legal,
but a false or stale header never delays the frames behind it.
"""

import binascii
import heapq
import re
from bisect import bisect_right
from collections import deque

from steerd.steer_bus.quick_values import quick_value

MAX_PAYLOAD = 512
"""Largest payload since firmware 3.48 [bytes]."""
RUNNING_CEILING = 128
"""Host ceiling while driving: no reply polled then is longer, so a false header dies young."""
HOST_GAP_NS = 15_000_000
"""Silence after which a partial frame is stale (`docs/reference/safety-requirements.md#s7.1`)."""
FLUSH = bytes(MAX_PAYLOAD + 8)
"""Written on open: zeros never start a frame, so they end any frame the device still waits for."""

_START = re.compile(rb"[\x02\x03]")
_STOP = 0x03
_OVERHEAD = 6
_CUT = 2
"""A header of so many bytes or fewer may be cut."""


def encode_frame(payload: bytes) -> bytes:
    """Wrap a payload (1 to 512 bytes, first byte the command id) in a frame.

    Raises:
        ValueError: the payload is empty or longer than any current firmware accepts.
    """
    size, crc = len(payload), binascii.crc_hqx(payload, 0)
    if not 1 <= size <= MAX_PAYLOAD:
        raise ValueError(f"a VESC payload has 1 to {MAX_PAYLOAD} bytes, not {size}")
    head = (2, size) if size < 256 else (3, size >> 8, size & 0xFF)
    return bytes(head) + payload + bytes((crc >> 8, crc & 0xFF, _STOP))


@quick_value
class Frame:
    """A checked payload and when its first byte was read [ns, monotonic]."""

    payload: bytes
    t_first_ns: int


class FrameParser:
    """Incremental frame parser; linear in the bytes fed, whatever they are.

    Args:
        max_payload: longest payload accepted; also bounds the buffer.
        strict: behave as the firmware does (see the module docstring).
        gap_ns: silence after which a partial frame is stale; default 15 ms on the host and none in
            the firmware (3.48 to 5.02 had 1 s). The host gives the first bytes after a silence the
            chance to complete the frame, because the silence may be the host's own; the firmware
            forgets everything.

    Attributes:
        ceiling: longest payload accepted from now on (512 while configuring, 128 while running);
            never above ``max_payload``.
    """

    def __init__(
        self, max_payload: int = MAX_PAYLOAD, strict: bool = False, gap_ns: int | None = None
    ) -> None:
        self.ceiling = max_payload
        self._max_payload = max_payload
        self._strict = strict
        self._gap_ns = HOST_GAP_NS if gap_ns is None and not strict else gap_ns
        self._buffer = bytearray()
        self._base = 0  # stream offset of the buffer's first byte
        self._next = 0  # stream offset of the first byte not yet looked at as a header
        self._taken = 0  # every byte before this stream offset is delivered or given up
        self._by_end: list[tuple[int, int]] = []  # heap of (end, start): candidates not complete
        self._by_start: deque[int] = deque()
        self._open: set[int] = set()
        self._reads: deque[tuple[int, int]] = deque()  # (stream offset, time) of each read

    @property
    def buffered(self) -> int:
        """Bytes held back for a frame that is not complete; never more than ``max_payload + 6``."""
        return len(self._buffer)

    def feed(self, data: bytes, t_ns: int) -> list[bytes]:
        """Take bytes read at ``t_ns`` and return the payloads they complete, in order."""
        return [frame.payload for frame in self.feed_stamped(data, t_ns)]

    def feed_stamped(self, data: bytes, t_ns: int) -> list[Frame]:
        """As `feed`, with the arrival time of each frame's first byte."""
        if not self._buffer and not data:
            return []  # nothing is open, so nothing is stale
        gap_ns, reads = self._gap_ns, self._reads
        stale = gap_ns is not None and bool(reads) and t_ns - reads[-1][1] > gap_ns
        held = len(self._buffer)
        if not stale and self._next == self._base and held <= _CUT:
            whole = self._take_whole(data, t_ns)
            if whole is not None:
                return whole
        old_total = self._base + held
        if not data and not stale:
            return []
        if stale and self._strict:
            self._give_up_before(old_total)
        if data:
            self._reads.append((old_total, t_ns))
            self._buffer += data
        found = self._complete_open() + self._scan()
        if stale:
            self._give_up_before(old_total)
        self._trim()
        return found

    def _take_whole(self, data: bytes, t_ns: int) -> list[Frame] | None:
        """The frames of a read that holds good frames and at most the cut header of a next one.

        Nearly every read is one: what was buffered before is such a header too, for USB sends a
        reply's first byte ahead. None where there is anything else. The general way gives the same,
        with candidates and offsets kept.
        """
        held = len(self._buffer)
        t_first_ns = t_ns
        if held:
            t_first_ns = self._time_of(self._base)
            data = bytes(self._buffer) + data
        at, total = 0, len(data)
        longest = self.ceiling if self.ceiling < self._max_payload else self._max_payload
        found: list[Frame] = []
        while at < total:
            kind = data[at]
            begin = at + kind
            if kind not in (2, 3):
                return None
            if begin > total:
                break
            size = data[at + 1] if kind == 2 else int.from_bytes(data[at + 1 : begin], "big")
            stop = begin + size + 2
            if not (1 if kind == 2 else 255) <= size <= longest or stop >= total:
                return None
            payload = data[begin : stop - 2]
            crc = data[stop - 2] << 8 | data[stop - 1]
            if data[stop] != _STOP or binascii.crc_hqx(payload, 0) != crc:
                return None
            found.append(Frame(bytes(payload), t_first_ns))
            t_first_ns = t_ns
            at = stop + 1
        if held and not found:
            return None
        self._reads = deque(((self._base + held, t_ns),))
        if found:
            self._base = self._next = self._taken = self._base + at
        self._buffer = bytearray(data[at:])
        return found

    def _complete_open(self) -> list[Frame]:
        """Judge the candidates that were incomplete before this read and are complete now."""
        total = self._base + len(self._buffer)
        ready = []
        while self._by_end and self._by_end[0][0] <= total:
            end, start = heapq.heappop(self._by_end)
            if start in self._open:
                ready.append((start, end))
        found: list[Frame] = []
        for start, end in sorted(ready):
            if start < self._taken:
                continue
            frame = self._judge(start, end)
            self._open.discard(start)
            if frame is not None:
                self._give_up_before(end)
                found.append(frame)
        return found

    def _scan(self) -> list[Frame]:
        """Look for headers in the bytes not seen before."""
        found: list[Frame] = []
        total = self._base + len(self._buffer)
        while match := _START.search(self._buffer, self._next - self._base):
            start = self._next = self._base + match.start()
            end = self._frame_end(start)
            if end is None:
                return found
            if end > total:
                if self._strict:
                    return found
                self._open_candidate(start, end)
            elif end and (frame := self._judge(start, end)):
                self._give_up_before(end)
                found.append(frame)
                continue
            self._next += 1
        self._next = total
        return found

    def _frame_end(self, start: int) -> int | None:
        """Stream offset behind the candidate: 0 if no legal header, None if the header is cut."""
        at = start - self._base
        kind = self._buffer[at]
        if len(self._buffer) < at + kind:
            return None
        size = int.from_bytes(self._buffer[at + 1 : at + kind], "big")
        if size > min(self.ceiling, self._max_payload) or size < (1 if kind == 2 else 255):
            return 0
        return start + kind + size + 3

    def _open_candidate(self, start: int, end: int) -> None:
        heapq.heappush(self._by_end, (end, start))
        self._by_start.append(start)
        self._open.add(start)

    def _judge(self, start: int, end: int) -> Frame | None:
        """Check stop byte and CRC of a complete candidate."""
        at, stop = start - self._base, end - self._base - 1
        payload = bytes(self._buffer[at + self._buffer[at] : stop - 2])
        crc = int.from_bytes(self._buffer[stop - 2 : stop], "big")
        if self._buffer[stop] != _STOP or binascii.crc_hqx(payload, 0) != crc:
            return None
        return Frame(payload, self._time_of(start))

    def _time_of(self, offset: int) -> int:
        reads = self._reads
        if offset >= reads[-1][0]:
            return reads[-1][1]
        return reads[bisect_right(reads, offset, key=lambda read: read[0]) - 1][1]

    def _first_open(self) -> int:
        """Stream offset of the earliest byte that may still belong to a frame."""
        while self._by_start and self._by_start[0] not in self._open:
            self._by_start.popleft()
        return self._by_start[0] if self._by_start else self._next

    def _give_up_before(self, offset: int) -> None:
        self._taken = max(self._taken, offset)
        self._next = max(self._next, self._taken)
        while self._by_start and self._by_start[0] < self._taken:
            self._open.discard(self._by_start.popleft())
        if not self._open:
            self._by_end.clear()

    def _trim(self) -> None:
        total = self._base + len(self._buffer)
        keep_from = max(self._first_open(), total - self._max_payload - _OVERHEAD)
        del self._buffer[: keep_from - self._base]
        self._base = keep_from
        while len(self._reads) > 1 and self._reads[1][0] <= keep_from:
            self._reads.popleft()
