"""`steerd.load`: a recorded drive as tables and a figure."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steerd.daemon.common.errors import SteerdError, reading
from steerd.daemon.common.notebook import load_package, make_frame
from steerd.daemon.common.screen import shown
from steerd.daemon.sessions import info
from steerd.steer_bus import session_read
from steerd.steer_bus.fields import flat_leaves, leaves_of
from steerd.steer_bus.session_read import MESSAGE_TYPES
from steerd.steer_bus.topic_columns import Columns
from steerd.steer_bus.topics import split_key
from steerd.sysid.report.report import Card

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure

Table = NDArray[np.void]  # a topic (n,): `t` [s] since the session's start, then every field


@shown
@dataclass(frozen=True, eq=False)
class Session:
    """A recorded drive.

    `print(session)` is the screen of `steerd info`. Topics go by their short names (`state`,
    `mocap`), or by their whole ones where a session holds two cars.

    Attributes:
        path: the session file.
    """

    path: Path
    _recording: session_read.Session = field(repr=False)

    def __fspath__(self) -> str:
        return str(self.path)

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that `table` gives, in alphabetical order."""
        return tuple(sorted(self._names))

    @property
    def duration(self) -> float:
        """First to last message [s]."""
        return self._recording.info().duration_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the file or implausible in its numbers."""
        return self.report.warnings

    @property
    def metadata(self) -> "Metadata":
        """What the recorder says of the drive: options, car, scaling, how it ended."""
        found = self._recording.info().metadata
        return Metadata({name: dict(values) for name, values in found.items()})

    @property
    def cards(self) -> list[Card]:
        """The key figures of the drive's page."""
        from steerd.daemon.sessions.plot_data import make_drawing
        from steerd.daemon.sessions.plot_page import list_facts

        drawing = make_drawing(self._read)
        return [Card(label, figure, "") for label, figure in list_facts(self.report, drawing)]

    @cached_property
    def report(self) -> info.SessionReport:
        """The numbers of `steerd info`."""
        return info.make_session_report(self._read)

    @cached_property
    def _read(self) -> info.Recording:
        """Every topic of steerd's, read in one pass for report, cards and figure."""
        return info.read_recording(self._recording)

    @cached_property
    def _names(self) -> dict[str, tuple[str, type[Any]]]:
        """Topic and message class by the name that a user writes."""
        known = {
            topic.name: MESSAGE_TYPES[topic.type_name]
            for topic in self._recording.info().topics
            if topic.count
            and topic.type_name in MESSAGE_TYPES
            and flat_leaves(MESSAGE_TYPES[topic.type_name]) is not None
        }
        short = [(split_key(name) or ("", name))[1] for name in known]
        return {
            (brief if short.count(brief) == 1 else name): (name, cls)
            for brief, (name, cls) in zip(short, known.items(), strict=True)
        }

    def table(self, topic: str) -> Table:
        """A topic as a structured array.

        Args:
            topic: a short name of `topics`, or the whole one.

        Returns:
            (n,) with the fields `t` [s] since the session's start, `log_ns` and `publish_ns`
            (UNIX), `sequence`, and the message's own, nested ones with dots; units as in
            docs/reference/sessions.md. Arrays of a message are (n, k); texts are objects.

        Raises:
            SteerdError: the session has no such topic, or has changed on disk.
        """
        return _make_table(self._columns(topic))

    def tables(self) -> dict[str, Table]:
        """All topics as structured arrays, in one pass over the file; raises as `table`."""
        wanted = dict(self._names.values())
        with reading(self.path):
            found = self._recording.tables(wanted)
        return {
            name: _make_table(self._with_time(found[topic]))
            for name, (topic, _) in sorted(self._names.items())
        }

    def to_pandas(self, topic: str) -> "pandas.DataFrame":
        """A topic as a data frame; arrays of a message become columns `name.0`, `name.1`, ….

        `drive["state"]` is the same. `attrs["units"]` holds the units by column.

        Raises:
            SteerdError: pandas is not installed, or as `table`.
        """
        units = {leaf.name: leaf.unit for leaf in leaves_of(self._find(topic)[1])} | _TIMES
        return make_frame(_flatten(self._columns(topic)), units)

    def __getitem__(self, topic: str) -> "pandas.DataFrame":
        return self.to_pandas(topic)

    def to_polars(self, topic: str) -> "polars.DataFrame":
        """A topic as a data frame; arrays of a message become columns `name.0`, `name.1`, ….

        Raises:
            SteerdError: polars is not installed, or as `table`.
        """
        flat = _flatten(self._columns(topic)).items()
        columns = {name: c.tolist() if c.dtype == object else c for name, c in flat}
        frame: polars.DataFrame = load_package("polars").DataFrame(columns)
        return frame

    def plot(self) -> "Figure":
        """Track over lane, errors, commands against measurements, over time.

        Raises:
            SteerdError: the session has changed on disk.
        """
        from steerd.daemon.analysis.figures import plot_session
        from steerd.daemon.sessions.plot_data import make_drawing

        return plot_session(make_drawing(self._read), self.path.name)

    def __str__(self) -> str:
        from steerd.daemon.sessions.text import format_report

        return format_report(self.report)

    def _find(self, topic: str) -> tuple[str, type[Any]]:
        """Whole topic and message class of a name; a SteerdError where there is no such topic."""
        for brief, (whole, cls) in self._names.items():
            if topic in (brief, whole):
                return whole, cls
        what = f"{self.path.name} has no table {topic!r}"
        raise SteerdError(what, f"it has {', '.join(self.topics) or 'none'}")

    def _columns(self, topic: str) -> Columns:
        whole, cls = self._find(topic)
        with reading(self.path):
            return self._with_time(self._recording.columns(cls, whole))

    def _with_time(self, columns: Columns) -> Columns:
        stamps = columns["stamp_ns"] if "stamp_ns" in columns else columns["log_ns"]
        return {"t": info.seconds_since(self._recording.info().start_ns, stamps), **columns}


class Metadata(dict[str, dict[str, str]]):
    """Texts by section and name; a cell shows the sections alone."""

    def __repr__(self) -> str:
        return f"<Metadata: {', '.join(self)}>"


_TIMES = {"t": "s", "log_ns": "ns", "publish_ns": "ns"}  # units of what every table has


def load(path: Path | str) -> Session:
    """Open a session file; unfinished and damaged ones open too, with `warnings`.

    Raises:
        SteerdError: it cannot be read, or is no session.
    """
    return Session(Path(path), info.load_session(Path(path)))


def _make_table(columns: Columns) -> Table:
    dtype = [(name, column.dtype, column.shape[1:]) for name, column in columns.items()]
    table = np.empty(len(columns["t"]), dtype)
    for name, column in columns.items():
        table[name] = column
    return table


def _flatten(columns: Columns) -> Columns:
    """Columns of one dimension each."""
    flat: Columns = {}
    for name, column in columns.items():
        if column.ndim == 1:
            flat[name] = column
        else:
            flat |= {f"{name}.{i}": part for i, part in enumerate(column.T)}
    return flat
