"""The table of `steerd sessions`: a line a drive, at most 80 columns."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any

from steerd.daemon.common.screen import clean, cut, wrap
from steerd.daemon.sessions.catalogue import Entry

_NAME, _CAR, _LANE = 20, 8, 17
"""Columns of the names [characters]."""


def format_entries(entries: Sequence[Entry], numbers: Sequence[int]) -> Iterator[str]:
    """The table, newest first.

    Args:
        entries: the drives.
        numbers: the place of each among all, 1 for the last: what `@-N` takes.
    """
    yield (
        f"{'':6}{'ended':<12}{'session':<{_NAME + 1}}{'car':<{_CAR + 1}}"
        f"{'driven':<{_LANE + 1}}{'m':>5}{'e1 mm':>8}"
    )
    for number, e in zip(numbers, entries, strict=True):
        when = datetime.fromtimestamp(e.changed_ns / 1e9).astimezone()
        place = "@last" if number == 1 else f"@-{number}"
        metres = "" if e.metres is None else f"{e.metres:.0f}"
        error = "" if e.e1_rms is None else f"{1e3 * e.e1_rms:.1f}"
        yield (
            f"{place:<6}{when:%m-%d %H:%M} {cut(clean(e.path.stem), _NAME):<{_NAME + 1}}"
            f"{cut(e.car, _CAR):<{_CAR + 1}}{cut(e.lane, _LANE):<{_LANE + 1}}"
            f"{metres:>5}{error:>8}"
        )
        yield from _remarks(e)


def _remarks(e: Entry) -> Iterator[str]:
    """What is not ordinary about a drive, and what people wrote."""
    parts = [] if e.verdict == "ok" else [e.verdict]
    parts += [f"records dropped within {e.missing_s:.1f} s"] if e.missing_s else []
    parts += [" ".join(f"#{tag}" for tag in e.tags)] if e.tags else []
    parts += [e.note] if e.note else []
    if parts:
        yield from wrap(" · ".join(parts), " " * 6, " " * 6)


def make_json(entries: Iterable[Entry]) -> dict[str, Any]:
    """The drives as JSON values."""
    names = (
        "changed_ns", "car", "mode", "lane", "seconds", "metres", "e1_rms", "e1_max", "verdict",
        "missing_s", "note",
    )  # fmt: skip
    return {
        "schema": "steerd.sessions/1",
        "sessions": [
            {
                "path": str(e.path),
                **{name: getattr(e, name) for name in names},
                "tags": list(e.tags),
            }
            for e in entries
        ],
    }
