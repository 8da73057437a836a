"""Lines for a terminal: whole words, no control characters; and the bar of a long command."""

import io
import shlex
import sys

from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.common import progress
from steerd.daemon.common.progress import show_progress
from steerd.daemon.common.screen import clean, join_words, wrap, wrap_command


@settings(derandomize=True, deadline=None)
@given(st.lists(st.text("abc-/.", min_size=1, max_size=30), min_size=1), st.integers(20, 90))
def test_lines_fit_and_words_stay_whole(words, width):
    lines = wrap(" ".join(words), "  head  ", "    ", width)
    assert " ".join(lines).split() == ["head", *words]
    for line in lines:
        assert len(line) <= width or len(line.split()) <= 2


def test_a_command_is_broken_where_a_shell_lets_it_be():
    command = "steerd run --sim --fast --duration 20 --car late.toml --path figure8 --speed 1.8"
    lines = wrap_command(command, "next        ", " " * 14)
    assert all(len(line) <= 80 for line in lines)
    assert all(line.endswith(" \\") for line in lines[:-1])
    typed = "\n".join(lines).replace("\\\n", "")
    assert shlex.split(typed) == ["next", *shlex.split(command)]
    assert wrap_command("steerd info x.mcap", "  ") == ["  steerd info x.mcap"]


def test_joined_words_stay_on_one_line():
    assert wrap(f"at most {join_words('12.0 m/s')}", width=14) == ["at most", "12.0 m/s"]
    assert wrap("") == []


def test_control_characters_are_replaced_and_long_texts_cut():
    assert clean("a\nb\x07\x1b[2J") == "a?b??[2J"
    assert clean("x" * 300) == "x" * 200 + "…"
    assert clean("café °", 4) == "café…"


# The bar of a long command names its step on a terminal, and is silent elsewhere.
def test_the_step_stands_beside_the_bar(monkeypatch):
    seen = io.StringIO()
    seen.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with show_progress("identifying", 2.0) as advance:
        advance(1.0, "learning the noise")
    assert "identifying: learning the noise" in seen.getvalue()
    assert "50%" in seen.getvalue()


def test_items_are_counted_as_they_pass():
    seen: list[int] = []
    assert list(progress.watched("abcdefg", seen.append, every=3)) == list("abcdefg")
    assert seen == [0, 3, 6]
