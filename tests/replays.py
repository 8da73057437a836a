"""Sessions with something changed, and what a replay gives without some of the messages."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from steerd.daemon.offline.replay import replay
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import MESSAGE_TYPES, Record, Session, open_session


def copy_session(
    source: Path, target: Path, *, metadata: Mapping[str, Mapping[str, str]] | None = None,
    attachments: Mapping[str, bytes] | None = None, change: Callable[[Record], bytes] | None = None,
) -> Path:  # fmt: skip
    """Copy a session with other metadata, attachments, or data of its records."""
    session = open_session(source)
    info = session.info()
    about: dict[str, Any] = {n: {**v} for n, v in info.metadata.items() if n != "steerd.end"}
    for name, values in (metadata or {}).items():
        about.setdefault(name, {}).update(values)
    files = {name: session.attachment(name) for name in info.attachments} | {**(attachments or {})}
    classes = {t.name: MESSAGE_TYPES[t.type_name] for t in info.topics}
    writer = SessionWriter(target, classes, about, files, info.start_ns)
    for record in session.messages():
        data = change(record) if change else record.data
        writer.write(record.topic, data, record.log_ns, record.publish_ns)
    return writer.finish({"reason": "copied"})


def count_differences_without(session: Session, ending: str, ticks: int) -> int:
    """Orders that differ where messages of the topics with this ending are kept from the replay.

    With them every order of more than `ticks` is given again, which is checked first.
    """
    run, differences = replay(session, "drive.mcap")
    assert list(differences) == []
    assert run.ticks > ticks
    deaf, _ = replay(session, "drive.mcap")
    heard = (record for record in session.messages() if not record.topic.endswith(ending))
    return sum(deaf.take(record) is not None for record in heard)
