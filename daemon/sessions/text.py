"""A session's report as text for one screen, and as JSON."""

from dataclasses import fields
from datetime import UTC, datetime
from math import degrees
from typing import Any

from steerd.daemon.assembly.session_meta import is_virtual
from steerd.daemon.common.screen import NBSP, WIDTH, clean, cut, join_words, wrap
from steerd.daemon.sessions.info import SessionReport, TopicReport
from steerd.daemon.sessions.motion import SignalRange
from steerd.steer_bus.topics import split_key
from steerd.sysid.report.report import Table, finite, format_table

TOPICS_SHOWN = 18
STATES_SHOWN = 10
EMPTY_SHOWN = 12
_LABEL = 12
_NAME_MIN, _NAME_MAX, _TYPE_MIN = 12, 24, 6  # columns of the topic table [characters]


def format_report(report: SessionReport) -> str:
    """The report as lines of at most `WIDTH` columns."""
    info = report.info
    lines = [clean(info.path.name)]
    lines += _item("car", _car(report))
    lines += _item("note", clean(info.metadata.get("steerd.session", {}).get("comment", "")))
    lines += _item("when", when(report))
    size = f"{info.size / 1e6:.1f} MB" if info.size >= 1e5 else f"{info.size / 1e3:.1f} kB"
    lines += _item("size", f"{size}, {_count(info.count)} messages")
    lines += _item("end", _end(report))
    if report.states:
        first, *later = report.states[:STATES_SHOWN]
        changes = (f" {join_words(f'→ {each.state.lower()} {each.t_s:.1f}')}" for each in later)
        more = len(report.states) - STATES_SHOWN
        rest = f" → … {more} more" if more > 0 else ""
        lines += _item("states", f"{first.state.lower()}{''.join(changes)}{rest}{NBSP}s")
    lines += _item("drive", _drive(report))
    for remark in report.excitation:
        lines += _item("", remark)
    return "\n".join([*lines, "", *_topics(report)])


def _item(label: str, text: str) -> list[str]:
    return wrap(text, f"  {label:<{_LABEL - 2}}", " " * _LABEL) if text else []


def _car(report: SessionReport) -> str:
    about = report.info.metadata.get("steerd.session")
    if about is None:
        return ", ".join(filter(None, (clean(report.car), "not recorded by steerd")))
    modes = {
        "hw": "on the car",
        "sim": "simulated hardware",
        "import": f"imported from {clean(about.get('source', 'another log'))}",
    }
    mode = modes.get(report.mode, clean(report.mode))
    return ", ".join(filter(None, (clean(report.car), mode)))


def when(report: SessionReport) -> str:
    """When a session was recorded, and how long it is."""
    info = report.info
    if not info.count:
        return "no messages"
    span = f"{info.duration_s:,.1f} s".replace(",", " ")
    if is_virtual(info):
        return f"{span} of virtual time"
    day_ns = 86_400_000_000_000
    if not day_ns * 365 < info.start_ns < 1 << 62:
        return f"{span} (the date is not recorded)"
    start = datetime.fromtimestamp(info.start_ns // 1_000_000_000, UTC)
    return f"{start:%Y-%m-%d %H:%M:%S} UTC, {span}"


def _end(report: SessionReport) -> str:
    metadata = report.info.metadata
    recovered = metadata.get("steerd.recovered", {}).get("source", "")
    tail = f"; recovered from {clean(recovered)}" if recovered else ""
    if report.info.clean:
        dropped = metadata["steerd.end"].get("dropped", "0")
        lost = "" if dropped in ("0", "") else f", {clean(dropped)} messages dropped"
        return f"{clean(next(iter(report.stops), report.end)) or 'recorded'}{lost}{tail}"
    if recovered:
        return f"not recorded: the recorder was killed{tail}"
    if report.info.finished:
        return "not recorded"
    name = clean(str(report.info.path))
    command = join_words(f"steerd recover {name}")
    return f"the recorder was killed or is still writing; to repair it: {command}"


def _drive(report: SessionReport) -> str:
    parts = []
    if report.length_m is not None:
        parts.append(f"{report.length_m:.1f} m")
    if report.speed:
        parts.append(f"speed {_span(report.speed)} m/s")
    if report.steer:
        span, sd = _span(report.steer, degrees(1.0)), degrees(report.steer.sd)
        parts.append(f"steering {span}° (sd {sd:.1f})")
    if report.lateral_accel:
        worst = max(-report.lateral_accel.low, report.lateral_accel.high)
        parts.append(f"lateral acceleration up to {worst:.1f} m/s²")
    return ", ".join(map(join_words, parts))


def _span(found: SignalRange, scale: float = 1.0) -> str:
    return f"{scale * found.low:z.1f} to {scale * found.high:z.1f}"


def _topics(report: SessionReport) -> list[str]:
    shown = report.topics[:TOPICS_SHOWN]
    if not shown:
        return []
    rows = [
        (
            _short(t.name), clean(t.type_name.rpartition("/")[2] or "?", 40), _count(t.count),
            f"{t.rate_hz:.1f} Hz" if t.gaps is not None else "", _gaps(t),
        )
        for t in shown
    ]  # fmt: skip
    # At most `WIDTH` columns wide: names and types are cut before figures are.
    heads = ("topic", "type", "messages", "rate", "gaps")
    name, kind, *figures = (max(map(len, column)) for column in zip(heads, *rows, strict=True))
    room = max(WIDTH - 2 * len(heads) - sum(figures), _NAME_MIN + _TYPE_MIN)
    name = min(name, _NAME_MAX, room - _TYPE_MIN)
    cells = [(cut(row[0], name), cut(row[1], min(kind, room - name)), *row[2:]) for row in rows]
    lines = [f"  {line}" for line in format_table(Table(heads, cells, words=(1, 4)))]
    if more := len(report.topics) - len(shown):
        lines.append(f"  … and {more} topics more (--json lists them)")
    if report.empty_topics:
        names = ", ".join(_short(name) for name in report.empty_topics[:EMPTY_SHOWN])
        lines += wrap(names, "  no messages: ", "    ")
    return lines


def _short(name: str) -> str:
    key = split_key(name)
    return clean(key[1] if key else name, 40)


def _gaps(topic: TopicReport) -> str:
    if topic.gaps is None:
        return ""
    if not topic.gaps:
        return "none"
    return f"{topic.gaps}, worst {topic.longest_gap_s:.3g} s at {topic.longest_gap_at_s:.1f} s"


def _count(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def make_json(report: SessionReport) -> dict[str, Any]:
    """The report as JSON values; a number that is not finite is null."""
    info, data = report.info, {f.name: getattr(report, f.name) for f in fields(report)}
    del data["info"]
    drive = ("length_m", "speed", "steer", "lateral_accel", "excitation")
    document = {
        "schema": "steerd.info/1",
        "path": str(info.path),
        "size_bytes": info.size,
        "start_ns": info.start_ns,
        "duration_s": info.duration_s,
        "messages": info.count,
        "finished": info.finished,
        "clean": info.clean,
        "drive": {name: data.pop(name) for name in drive},
        "metadata": {name: dict(values) for name, values in info.metadata.items()},
        "attachments": info.attachments,
    }
    made: dict[str, Any] = finite(document | data)
    return made
