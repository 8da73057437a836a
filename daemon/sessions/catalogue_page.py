"""The page of recorded drives: one row each, with the way to its own page."""

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from steerd.daemon.common.screen import clean
from steerd.daemon.sessions.catalogue import Entry
from steerd.sysid.report.report import Card, Cell, Report, Section, Table

_HEADS = (
    "session", "how it ended", "when", "driven", "e1 RMS [mm]", "e1 largest [mm]",
    "fastest [m/s]", "time [s]", "length [m]", "car",
)  # fmt: skip


def make_report(entries: Sequence[Entry], folder: Path) -> Report:
    """What the page shows.

    Args:
        entries: the drives, in the table's order.
        folder: where the page will lie; its links start there.
    """
    minutes = sum(e.seconds for e in entries) / 60.0
    cards = [
        Card("drives", str(len(entries)), f"{sum(e.verdict != 'ok' for e in entries)} not ok"),
        Card("driven", f"{sum(e.metres or 0.0 for e in entries):.0f} m", f"in {minutes:.1f} min"),
    ]
    errors = [(e.e1_max, clean(e.path.stem)) for e in entries if e.e1_max is not None]
    if errors:
        largest, name = max(errors)
        cards.append(Card("largest e1", f"{1e3 * largest:.1f} mm", name))
    table = Table(_HEADS, [_row(e, folder) for e in entries], words=(0, 1, 3, 9))
    text = (
        "A name leads to the drive's page, where `steerd plot` has made one beside the session. e1 "
        "is the distance from the lane later than 3 s after the start."
    )
    return Report(
        title="Recorded drives",
        subject="",
        about="",
        lead="" if entries else "There is none.",
        cards=cards,
        sections=[Section(text=text, table=table)] if entries else [],
        foot="Written by steerd sessions. Times are local, those of the end.",
    )


def _row(e: Entry, folder: Path) -> list[str | Cell]:
    page = e.path.with_suffix(".html")
    link = quote(os.path.relpath(page, folder)) if page.is_file() else ""
    figures = [
        "–" if value is None else format(value * scale, ".1f")
        for value, scale in (
            (e.e1_rms, 1e3), (e.e1_max, 1e3), (e.speed, 1.0), (e.seconds, 1.0), (e.metres, 1.0),
        )
    ]  # fmt: skip
    ended = Cell(e.remarks or "ok", "" if e.verdict == "ok" else "strong")
    named = Cell(clean(e.path.stem), link=link)
    return [named, ended, f"{e.when:%Y-%m-%d %H:%M}", e.lane, *figures, e.car]
