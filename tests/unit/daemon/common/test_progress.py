"""The bar of a long command names its step on a terminal, and is silent elsewhere."""

import io
import sys

from steerd.daemon.common import progress
from steerd.daemon.common.progress import show_progress


class Terminal(io.StringIO):
    """Standard error that somebody looks at."""

    def isatty(self):
        return True


def watched(monkeypatch):
    """A terminal of 120 columns, in place of standard error."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    return terminal


def test_the_step_stands_beside_the_bar(monkeypatch):
    seen = watched(monkeypatch)
    with show_progress("identifying", 2.0) as advance:
        advance(1.0, "learning the noise")
    assert "identifying: learning the noise" in seen.getvalue()
    assert "50%" in seen.getvalue()


def test_items_are_counted_as_they_pass():
    seen: list[int] = []
    assert list(progress.watched("abcdefg", seen.append, every=3)) == list("abcdefg")
    assert seen == [0, 3, 6]
