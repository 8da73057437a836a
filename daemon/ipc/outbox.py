"""Outgoing messages of the core: counted per topic, encoded once, given to every sink.

Messages are values: they are encoded at `flush`, after the tick's bytes were written.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.steer_bus.codec import CodecError, encode
from steerd.steer_bus.topics import Topic

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
        records, wrong = _encode_all(queued)
        for sink in self.sinks:
            sink(records, t_ns)
        if wrong is not None:
            raise wrong


def _encode_all(queued: list[_Queued]) -> tuple[list[PipeRecord], CodecError | None]:
    """Encode each record; also return the first error."""
    records, wrong = [], None
    for topic, count, log_ns, publish_ns, message in queued:
        try:
            records.append(PipeRecord(topic, count, log_ns, publish_ns, encode(message), message))
        except CodecError as error:
            wrong = wrong or error
    return records, wrong
