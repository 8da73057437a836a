"""The VESC's sending side: frames cut as USB cuts them, late, or damaged by the fault state.

Bytes are in flight with their times, and logged for judges. Times are int nanoseconds on whatever
monotonic clock the caller keeps; a device never asks for the time.
"""

from collections import deque
from typing import NamedTuple

from steerd.sim_hw.plant.faults import HEALTHY_VESC, VescFaultState
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.sim_hw.vesc.vesc_motor import MS, VescConfig
from steerd.vesc_link.frames import encode_frame

Chunk = tuple[int, bytes]  # bytes behind the time at which they reach the other end [ns]


class Logged(NamedTuple):
    """Bytes that went over the link, with their time: ``to`` is ``vesc`` or ``host``."""

    t_ns: int
    to: str
    data: bytes


FALSE_HEADER = b"\x03\x02\x00"  # the head of a frame of 512 bytes
_UNKNOWN_FRAME = encode_frame(b"\xfaunsolicited")
_USB_WAIT_NS = 100 * MS  # how long the firmware's USB thread waits for a host that does not read


class ReplyWire:
    """Replies in flight to the host."""

    def __init__(self, config: VescConfig, noise: NoiseSource, log: list[Logged] | None) -> None:
        self.fault_state: VescFaultState = HEALTHY_VESC  # what is wrong with the link
        self.next_ns: int | None = None  # when the next bytes are due; None without any
        self.blocked_until_ns = 0  # the command thread waits for the host to read
        self._config = config
        self._noise, self._log = noise, log
        self._chunks: deque[Chunk] = deque()
        self._last_ns = 0
        self._unread = 0
        self._broken = False

    def reset(self) -> None:
        """Forget a broken-off frame and everything in flight (new cable, reboot)."""
        self._chunks.clear()
        self.next_ns = None
        self._unread = 0
        self._broken = False

    def read(self, t_ns: int) -> bytes:
        """What the host reads at ``t_ns``: all that is due."""
        chunks, data = self._chunks, b""
        while chunks and chunks[0][0] <= t_ns:
            due_ns, part = chunks.popleft()
            data += part
            if self._log is not None:
                self._log.append(Logged(due_ns, "host", part))
        self.next_ns = chunks[0][0] if chunks else None
        count = len(data)
        self._unread = self._unread - count if count < self._unread else 0
        return data

    def send(self, t_ns: int, payload: bytes) -> None:
        """Send a reply as a frame."""
        faults, noise = self.fault_state, self._noise
        if faults.mute or not faults.truncate:
            self._broken = False
        if faults.mute or self._broken or noise.chance(faults.drop):
            return
        frame = encode_frame(payload)
        if noise.chance(faults.corrupt):
            bit, damaged = int(noise.uniform() * 8 * len(frame)), bytearray(frame)
            damaged[bit // 8] ^= 1 << bit % 8
            frame = bytes(damaged)
        if faults.truncate:
            frame, self._broken = frame[: len(frame) // 2], True
        due = t_ns + self._config.reply_delay_ns
        if faults.jitter_ns:
            due += int(faults.jitter_ns * noise.uniform())
        if faults.unsolicited:
            self._put(t_ns, due, _UNKNOWN_FRAME)
        if faults.garbage:
            self._put(t_ns, due, noise.random_bytes(faults.garbage))
        self._put(t_ns, due, frame)

    def send_raw(self, t_ns: int, data: bytes) -> None:
        """Send bytes that are no frame."""
        self._put(t_ns, t_ns, data)

    def _put(self, t_ns: int, due: int, data: bytes) -> None:
        size, room = len(data), self._config.unread_limit - self._unread
        if size > room:
            self.blocked_until_ns = t_ns + _USB_WAIT_NS
            size = max(0, room)
            data = data[:size]
        if not data:
            return
        self._unread += size
        trickle = self.fault_state.trickle_ns
        if trickle:
            due = max(due, self._last_ns)
            for i in range(size):
                self._queue(due + (i + 1) * trickle, data[i : i + 1])
            return
        first = self._queue(due, data[:1])
        if size > 1:
            self._queue(first + self._config.fragment_gap_ns, data[1:])

    def _queue(self, t_ns: int, data: bytes) -> int:
        """Bytes due at ``t_ns``, or when those before them are out: no byte overtakes another."""
        if t_ns > self._last_ns:
            self._last_ns = t_ns
        self._chunks.append((self._last_ns, data))
        if self.next_ns is None:
            self.next_ns = self._last_ns
        return self._last_ns
