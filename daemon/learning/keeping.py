"""Writing what is learnt, once a minute and at the end, beside the car file."""

from collections.abc import Callable
from dataclasses import dataclass

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.learning.kept import About, format_kept
from steerd.steer_bus import messages as m

EVERY_NS = 60_000_000_000
"""Drive time between two writings."""


@dataclass
class Keeper:
    """Takes reports and writes some of them.

    Attributes:
        about: of what the page is.
        write: replaces the page, whole or not at all; raises OSError or SteerdError.
        complain: is given one line where the page cannot be written.
        newest: the last report that knows the car and is not written yet.
        due_ns: when the page is written next (monotonic), None before the first.
        failed: whether writing failed; then it is not tried again.
    """

    about: About
    write: Callable[[str], None]
    complain: Callable[[str], None]
    newest: m.Model | None = None
    due_ns: int | None = None
    failed: bool = False

    def take(self, report: m.Model) -> None:
        """Take a report; one of a car that is not known yet says nothing new."""
        if report.verdict == "learning":
            return
        self.newest = report
        if self.due_ns is None or report.mono_ns >= self.due_ns:
            self.due_ns = report.mono_ns + EVERY_NS
            self.end()

    def end(self) -> None:
        """Write the last report, if it is not written."""
        if self.newest is None or self.failed:
            return
        try:
            self.write(format_kept(self.about, self.newest))
        except (OSError, SteerdError) as error:
            self.failed = True
            self.complain(f"what was learnt cannot be kept ({error})")
        self.newest = None
