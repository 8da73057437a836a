"""Session files: one MCAP per drive, written so that a crash loses a quarter of a second.

A session is written as ``NAME.mcap.partial`` and gets its name when it is finished; its absence
means a crash, and :func:`recover` (or reading the partial file directly) gets the rest back.
Reading is :mod:`steerd.steer_bus.session_read`.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping
from mimetypes import guess_type
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO

from mcap.writer import Writer  # noqa: TID251

from steerd.steer_bus.atomic_file import is_full
from steerd.steer_bus.container_write import ContainerWriter
from steerd.steer_bus.fields import schema_text, type_name
from steerd.steer_bus.session_read import Session, SessionError, open_session

# How often the kernel and the disk get everything: the most that a SIGKILL and a power cut can lose
# [ns]. Source: `docs/reference/sessions-and-bus.md#b4.2`.
FLUSH_NS, SYNC_NS = 250_000_000, 1_000_000_000
SCHEMA_VERSION, _SESSION = "1", "steerd.session"
_MAX_TIME_NS = (1 << 63) - 1


class SessionWriter:
    """Writes one session; owned by one thread, except :meth:`sync`.

    Metadata and attachments are on disk before the first message, so they survive any crash. After
    the first error of the disk nothing more is written: what comes behind a record that was cut
    could not be found again. Every method raises SessionError where the disk takes no more.
    ``log_ns`` is UNIX time when a sample was taken and never goes back within a file; a stamp that
    would (the host's clock was set) is raised to the last one.
    """

    def __init__(
        self,
        path: Path,
        topics: Mapping[str, type[Any]],
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, bytes] = MappingProxyType({}),
        start_ns: int = 0,
        flush_ns: int = FLUSH_NS,
    ) -> None:
        """Create ``path`` + ``.partial`` and write what is known at the start.

        Args:
            path: the final name, ending in ``.mcap``.
            topics: session topic to message class.
            metadata: records such as ``steerd.session`` and ``steerd.vehicle``.
            attachments: files to keep inside, such as the exact configuration, by name.
            start_ns: UNIX time of the attachments [ns].
            flush_ns: how often :meth:`tick` flushes [ns].

        Raises:
            SessionError: if a file of this name exists or cannot be created; none is left then.
        """
        self.path, self.partial = path, path.with_name(path.name + ".partial")
        self._file = _create(self.path, self.partial)
        self._broken: SessionError | None = None
        self._last_log_ns, self._flush_ns = 0, flush_ns
        self._flushed_ns = self._synced_ns = -(1 << 62)
        self._sequences = dict.fromkeys(topics, 0)
        try:
            with self._disk():
                self._writer: Writer = ContainerWriter(self._file, "ros2")
                for name, values in metadata.items():
                    version = {"schema_version": SCHEMA_VERSION} if name == _SESSION else {}
                    self._writer.add_metadata(name, {**version, **values})
                for name, data in attachments.items():
                    kind = guess_type(name)[0] or "application/toml"
                    self._writer.add_attachment(start_ns, start_ns, name, kind, data)
                self._channels = {}
                for topic, cls in topics.items():
                    text = schema_text(cls).encode()
                    schema = self._writer.register_schema(type_name(cls), "ros2msg", text)
                    self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
                self._file.flush()
                _sync_folder(path)
        except SessionError:
            self.partial.unlink(missing_ok=True)  # it holds no message, nothing can be recovered
            raise

    @property
    def count(self) -> int:
        """Number of messages written."""
        return sum(self._sequences.values())

    def write(self, topic: str, data: bytes, log_ns: int, publish_ns: int | None = None) -> None:
        """Append one encoded message.

        Args:
            topic: one of the topics given at the start.
            data: the encoded message.
            log_ns: UNIX time when it was taken [ns].
            publish_ns: UNIX time at its source [ns]; ``log_ns`` if left out.

        Raises:
            KeyError: on a topic that was not declared.
        """
        channel = self._channels[topic]
        log_ns = self._last_log_ns = min(max(log_ns, self._last_log_ns), _MAX_TIME_NS)
        published = log_ns if publish_ns is None else min(max(publish_ns, 0), _MAX_TIME_NS)
        sequence = self._sequences[topic] = self._sequences[topic] + 1
        if self._broken is not None:
            raise self._broken
        try:
            self._writer.add_message(channel, log_ns, data, published, sequence & 0xFFFFFFFF)
        except OSError as error:
            raise self._fail(error) from error

    def flush(self) -> None:
        """Close the chunk and hand everything to the kernel (survives SIGKILL, not power loss)."""
        with self._disk():
            self._writer.flush()

    def tick(self, t_ns: int) -> bool:
        """Flush if it is time (a quarter of a second by default); say whether :meth:`sync` is due.

        Args:
            t_ns: monotonic time now [ns].
        """
        if t_ns - self._flushed_ns >= self._flush_ns:
            self.flush()
            self._flushed_ns = t_ns
        if t_ns - self._synced_ns < SYNC_NS:
            return False
        self._synced_ns = t_ns
        return True

    def sync(self) -> None:
        """Wait until the disk has what was flushed; a second thread may, until ``finish``."""
        if self._broken is not None:
            raise self._broken
        try:
            os.fdatasync(self._file.fileno())
        except OSError as error:
            raise self._explain(error) from error

    def finish(self, end: Mapping[str, str]) -> Path:
        """Write ``steerd.end`` (why: ``reason``, ...) and the summary, sync, name the file.

        On an error what was flushed stays in ``.partial``.
        """
        with self._disk():
            self._writer.flush()
            self._writer.add_metadata("steerd.end", dict(end))
            _finish(self._writer, self._file, self.partial, self.path)
        return self.path

    def abandon(self) -> None:
        """Close without finishing; the ``.partial`` file stays and can be recovered."""
        _close_quietly(self._file)

    @contextlib.contextmanager
    def _disk(self) -> Iterator[None]:
        """Turn the first error of the disk into the error of every later call."""
        if self._broken is not None:
            raise self._broken
        try:
            yield
        except OSError as error:
            raise self._fail(error) from error

    def _fail(self, error: OSError) -> SessionError:
        self.abandon()
        self._broken = self._explain(error)
        return self._broken

    def _explain(self, error: OSError) -> SessionError:
        saved = "; `steerd recover` saves what was written" if self.count else ""
        return _disk_error(self.partial, error, f"free some space{saved}")


def recover(session: Session, path: Path) -> float:
    """Copy everything readable of an unfinished or damaged session into a new, finished file.

    ``steerd.end`` is copied only if it is there, so the result still says that the drive crashed;
    ``steerd.recovered`` says where it comes from. The result is read back before the end. Gives the
    longest time without any message [s]: where something is missing.

    Raises:
        SessionError: if the file exists, or the disk fails.
    """
    info, partial = session.info(), path.with_name(path.name + ".recovering")
    file = _create(path, partial)
    try:
        writer = ContainerWriter(file, info.profile)
        gap_ns = _copy(session, writer)
        source = {"source": info.path.name, "lost_bytes": str(info.lost)}
        writer.add_metadata("steerd.recovered", source)
        _finish(writer, file, partial, path)
    except OSError as error:
        raise _disk_error(partial, error, "free some space, or choose another folder") from error
    finally:
        _close_quietly(file)
        partial.unlink(missing_ok=True)  # not there any more once it is finished
    written = open_session(path).info()
    if written.count != info.count or written.warnings:
        raise SessionError("recover_failed", f"{path} does not read back as written")
    return gap_ns * 1e-9


def _copy(session: Session, writer: Writer) -> int:
    """Copy definitions, texts and messages; give the longest gap between messages [ns]."""
    contents = session.info()
    for name, values in contents.metadata.items():
        writer.add_metadata(name, values)
    for a in session.attachments():
        writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
    schemas = {
        key: writer.register_schema(schema.name, schema.encoding, schema.data)
        for key, schema in contents.schemas.items()
    }
    channels = {}
    for key, c in contents.channels.items():
        schema = schemas.get(c.schema_id, 0)
        channels[key] = writer.register_channel(c.topic, c.message_encoding, schema, c.metadata)
    gap_ns, last_ns = 0, None
    for r in session.messages():
        writer.add_message(channels[r.channel], r.log_ns, r.data, r.publish_ns, r.sequence)
        gap_ns = max(gap_ns, r.log_ns - (r.log_ns if last_ns is None else last_ns))
        last_ns = r.log_ns
    return gap_ns


def _create(path: Path, partial: Path) -> BinaryIO:
    try:
        if path.exists():
            raise FileExistsError
        return partial.open("xb")
    except FileExistsError:
        text = f"{path if path.exists() else partial} exists and is never overwritten"
        raise SessionError("exists", text, "choose another name") from None
    except OSError as error:
        text = f"{partial} cannot be created: {error.strerror}"
        raise SessionError("disk", text) from error


def _finish(writer: Writer, file: BinaryIO, partial: Path, path: Path) -> None:
    writer.finish()
    file.flush()
    os.fsync(file.fileno())
    file.close()
    if path.exists():
        raise FileExistsError(0, f"{path.name} has appeared meanwhile")
    partial.rename(path)
    _sync_folder(path)


def _sync_folder(path: Path) -> None:
    folder = os.open(path.absolute().parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _close_quietly(file: BinaryIO) -> None:
    """Close a file whose last bytes the disk may refuse: that was said already."""
    with contextlib.suppress(OSError):
        file.close()


def _disk_error(path: Path, error: OSError, hint: str) -> SessionError:
    what = f"{path} cannot be written: {error.strerror}"
    return SessionError("disk", what, hint if is_full(error) else "")
