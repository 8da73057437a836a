"""Sessions from disk: what a recording holds, as messages in recorded order or as columns.

:func:`open_session` checks the whole file once (CRCs, caps) and opens unfinished and damaged
files too, with warnings; the :class:`Session` it gives keeps the file open and reads its parts on
demand.
"""

# Why: docs/decisions/messages-and-sessions.md#d17

import json
import math
import os
import stat
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel  # noqa: TID251

from steerd.steer_bus import container
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.container import SessionInfo
from steerd.steer_bus.fields import schema_text, type_name
from steerd.steer_bus.messages import OWN_MESSAGES
from steerd.steer_bus.standard import STANDARD_MESSAGES
from steerd.steer_bus.topic_columns import ColumnBuilder, Columns

MESSAGE_TYPES: dict[str, type[Any]] = {
    type_name(cls): cls for cls in (*OWN_MESSAGES, *STANDARD_MESSAGES)
}

UNREADABLE, WRONG_CONTENT = 3, 4


class SessionError(Exception):
    """A session that cannot be used, in one line, with what to do about it."""

    def __init__(self, code: str, message: str, hint: str = "", exit_code: int = UNREADABLE):
        super().__init__(f"{message} ({hint})" if hint else message)
        self.code = code  # a stable word for programs
        self.hint = hint  # what the user can do; may be empty
        self.exit_code = exit_code  # 3 if it cannot be read, 4 if it holds the wrong content


@dataclass(frozen=True, slots=True)
class Record:
    """One recorded message, decoded on request; ``channel`` is its number in the file."""

    topic: str
    type_name: str
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes
    channel: int

    def decode(self) -> Any:
        """Decode the message by its recorded type.

        Raises:
            CodecError: if the type is none of ours or the bytes are not it.
        """
        cls = MESSAGE_TYPES.get(self.type_name)
        if cls is None:
            raise CodecError(f"{self.topic}: {self.type_name!r} is not a type steerd knows")
        return decode(cls, self.data)


class Session:
    """A recorded drive. Made by :func:`open_session`; its file stays open as long as it is used.

    What reads the file again raises SessionError if it has changed since.
    """

    def __init__(self, path: Path, file: FileIO) -> None:
        weakref.finalize(self, file.close)
        self._path, self._file = path, file.fileno()
        _check_magic(path, os.pread(self._file, len(container.MAGIC), 0))
        self._info = container.read_contents(path, self._file, file.seek(0, os.SEEK_END))

    def info(self) -> SessionInfo:
        """Give topics, counts, times, metadata and warnings."""
        return self._info

    def messages(self, *topics: str) -> Iterator[Record]:
        """Yield messages of these topics (all if none is named) in recorded order.

        Raises:
            SessionError: if the file has changed since it was opened.
        """
        wanted = {
            key: (channel.topic, self._info.schema(channel).name)
            for key, channel in self._info.channels.items()
            if not topics or channel.topic in topics
        }
        for data in map(self._read, self._info.spans):
            found = container.scan_messages(data)[0]
            places = ((a, b, key) for key in found.keys() & wanted.keys() for a, b in found[key])
            for start, end, key in sorted(places):
                topic, name = wanted[key]
                sequence, log_ns, publish_ns = container.MESSAGE_FIELDS.unpack_from(data, start)
                payload = data[start + container.MESSAGE_FIELDS.size : end]
                yield Record(topic, name, sequence, log_ns, publish_ns, payload, key)

    def columns(self, cls: type[Any], topic: str = "") -> Columns:
        """Read one topic, or the first of this type, as `topic_columns.Columns`, as recorded.

        Raises:
            SessionError: if the topic is missing, of another type or layout, or holds a message
                that is not what its schema says.
            TypeError: if the class holds a sequence of messages.
        """
        kind = type_name(cls)
        first = (t.name for t in self._info.topics if t.type_name == kind)
        name = topic or next(first, kind)
        return self.tables({name: cls})[name]

    def tables(self, wanted: Mapping[str, type[Any]]) -> dict[str, Columns]:
        """Read several topics as columns in one pass over the file; raises as :meth:`columns`."""
        builders: dict[str, ColumnBuilder] = {}
        by_channel: dict[int, str] = {}
        for topic, cls in wanted.items():
            builders[topic] = ColumnBuilder(cls)
            by_channel |= dict.fromkeys(self._channels(topic, cls), topic)
        try:
            for data in map(self._read, self._info.spans):
                for key, places in container.scan_messages(data)[0].items():
                    if key in by_channel:
                        builders[by_channel[key]].add([data[a:b] for a, b in places])
            return {topic: builder.finish() for topic, builder in builders.items()}
        except CodecError as error:
            text = f"{self._path.name}: a recorded message is not what its schema says: {error}"
            raise SessionError("bad_message", text, exit_code=WRONG_CONTENT) from error

    def attachment(self, name: str) -> bytes:
        """Read an attached file.

        Raises:
            SessionError: if there is none of this name, or the file has changed.
        """
        item = next((a for a in self.attachments() if a.name == name), None)
        if item is None:
            text = f"{self._path.name} has no attachment {name!r}"
            raise SessionError("missing_attachment", text, exit_code=WRONG_CONTENT)
        return item.data

    def attachments(self) -> Iterator[Attachment]:
        """Read the attached files."""
        for _, span in self._info.attached:
            yield container.parse(Attachment, self._read(span))

    def holes(self) -> tuple[tuple[int, int], ...]:
        """Stretches in which the recorder did not get everything [UNIX ns], in order.

        Raises:
            SessionError: what the session says of them makes no sense.
        """
        text = self._info.metadata.get("steerd.end", {}).get("holes", "[]")
        try:
            found = tuple((int(first), int(last)) for first, last in json.loads(text))
        except (ValueError, TypeError, RecursionError):
            what = f"{self._path.name}: holes is {text[:40]!r}, which is no list of times"
            raise SessionError("bad_holes", what, exit_code=WRONG_CONTENT) from None
        return found

    def number(self, record: str, key: str, default: float) -> float:
        """A number of the metadata; the default where it does not say.

        Raises:
            SessionError: what it says is no finite number.
        """
        text = self._info.metadata.get(record, {}).get(key)
        try:
            value = default if text is None else float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            return value
        what = f"{self._path.name}: {record} {key} is {str(text)[:40]!r}, which is no number"
        raise SessionError("bad_number", what, exit_code=WRONG_CONTENT)

    def check_layouts(self) -> None:
        """Refuse messages of steerd's types whose fields another version recorded.

        Raises:
            SessionError: a topic has other fields than its type has today.
        """
        for topic in self._info.topics:
            if topic.type_name in MESSAGE_TYPES:
                self._channels(topic.name, MESSAGE_TYPES[topic.type_name])

    def _channels(self, topic: str, cls: type[Any]) -> list[int]:
        found = [k for k, c in self._info.channels.items() if c.topic == topic]
        if not found:
            have = ", ".join(sorted(t.name for t in self._info.topics)) or "nothing"
            text = f"{self._path.name} has no topic {topic}; it has {have}"
            raise SessionError("missing_topic", text, exit_code=WRONG_CONTENT)
        for key in found:
            problem = _mismatch(self._info, self._info.channels[key], cls)
            if problem:
                text = f"{self._path.name}: {topic} {problem}"
                hint = "it was recorded by another version"
                raise SessionError("other_schema", text, hint, WRONG_CONTENT)
        return found

    def _read(self, span: container.Span) -> bytes:
        try:
            return container.read_span(self._file, span)
        except (OSError, container.DamageError) as error:
            text = f"{self._path.name} has changed since it was opened: {error}"
            raise SessionError("changed", text) from error


def open_session(path: Path | str) -> Session:
    """Open a session file, unfinished (``*.partial``) and damaged ones too, with warnings.

    Raises:
        SessionError: if it is no readable file, is empty, is no MCAP, or holds no message.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            kind = "a directory" if stat.S_ISDIR(mode) else "not a regular file"
            raise SessionError("not_a_file", f"{path} is {kind}", "name a session .mcap file")
        return Session(path, path.open("rb", buffering=0))
    except FileNotFoundError as error:
        partial = path.with_name(path.name + ".partial")
        hint = f"{partial.name} does: steerd recover {path}" if partial.exists() else ""
        raise SessionError("not_found", f"{path} does not exist", hint) from error
    except OSError as error:
        raise SessionError("unreadable", f"{path} cannot be read: {error.strerror}") from error


def _check_magic(path: Path, start: bytes) -> None:
    if not start:
        raise SessionError("empty", f"{path} is empty")
    if start != container.MAGIC:
        hint = ""
        if start.startswith(b"SQLite"):
            hint = "a rosbag2 .db3: convert it with `ros2 bag convert`"
        raise SessionError("not_mcap", f"{path} is not an MCAP file", hint)


def _mismatch(info: SessionInfo, channel: Channel, cls: type[Any]) -> str:
    schema = info.schema(channel)
    encodings = channel.message_encoding, schema.encoding
    if encodings != ("cdr", "ros2msg"):
        return f"is encoded as {encodings[0]!r} with {encodings[1]!r}, not cdr with ros2msg"
    if schema.name != type_name(cls):
        return f"holds {schema.name or 'no type'}, not {type_name(cls)}"
    recorded = _field_lines(schema.data.decode(errors="replace"))
    expected = _field_lines(schema_text(cls))
    if recorded == expected:
        return ""
    lost = [line for line in expected if line not in recorded]
    extra = [line for line in recorded if line not in expected]
    return f"has other fields: lacks {lost or 'none'}, adds {extra or 'none'}"


def _field_lines(text: str) -> list[str]:
    lines = (" ".join(line.split("#")[0].split()) for line in text.splitlines())
    return [line for line in lines if line and "=" not in line]
