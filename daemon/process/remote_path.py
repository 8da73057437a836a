"""Whether a stop from the bus would arrive: heartbeats that leave by the gateway must come back.

The way is core, gateway, bus, whoever holds the lease, bus, gateway, core. While nobody on the bus
holds it, the gateway hears the heartbeat itself: a person may want to stop the car from there.
"""

# Why: docs/decisions/safety.md#d113

from dataclasses import dataclass

from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.messages import BODY, Heartbeat, make_header

BEAT_NS = 50_000_000
"""Time between two heartbeats."""


@dataclass(slots=True)
class RemotePath:
    """Heartbeats of one run."""

    boot_id: int  # of this run; heartbeats of another are not ours
    holder: int = 0  # lease id of the operator who took the lease over the bus, 0 for nobody
    _asked: int = 0
    _due_ns: int = 0
    _back_ns: int | None = None

    def make_beat(self, now_ns: int, epoch_ns: int) -> Heartbeat | None:
        """The next heartbeat, if it is due."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + BEAT_NS
        return Heartbeat(make_header(now_ns + epoch_ns, BODY), self.boot_id, 0, now_ns)

    def take(self, data: bytes, now_ns: int) -> None:
        """A heartbeat came back; one that does not decode, or is somebody else's, is none."""
        try:
            beat = decode(Heartbeat, data)
        except CodecError:
            return
        ours = beat.boot_id == self.boot_id and beat.lease_id == self._asked
        if ours and (self._back_ns or 0) < beat.mono_ns <= now_ns:
            self._back_ns = beat.mono_ns

    def is_silent(self, held: bool, limit_s: float, now_ns: int) -> bool:
        """Whether too long no heartbeat came back from the holder, or `held` by none, the gateway.

        The gateway may take its time to start; whoever takes the lease has `limit_s` to answer.
        """
        asked = self.holder if held else 0
        if asked != self._asked:
            self._asked, self._back_ns = asked, now_ns
        return self._back_ns is not None and now_ns - self._back_ns > limit_s * 1e9
