"""Lines for a terminal, the bar of a long command, and values in a notebook."""

import io
import shlex
import sys
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.notebook import notebook_progress, speaking_of_arguments
from steerd.daemon.common.screen import (
    clean,
    join_words,
    show_progress,
    shown,
    watched,
    wrap,
    wrap_command,
)


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
    assert list(watched("abcdefg", seen.append, every=3)) == list("abcdefg")
    assert seen == [0, 3, 6]


# Values in a notebook: short inside others, the screen on their own.
@shown
@dataclass(frozen=True)
class Screen:
    text: str

    def __str__(self) -> str:
        return self.text


def test_a_value_is_one_line_inside_others_and_its_screen_at_a_cells_end():
    value = Screen("drives      one\nverdict     NONE. No gap < noise\nnext        nothing")
    assert repr([value]) == "[<steerd.Screen: verdict NONE. No gap < noise>]"
    assert value._repr_html_().startswith("<pre>drives")
    assert "gap &lt; noise" in value._repr_html_()
    assert repr(Screen("drive.mcap\n  car  car1")) == "<steerd.Screen: drive.mcap>"


@pytest.mark.parametrize(("said", "shown_as"), [
    ("name one with --base car.toml", "name one with base='car.toml'"),
    ("--held-out 0, or name a session", "held_out=0, or name a session"),
    ("--effect: no effect 'wings'", "effects: no effect 'wings'"),
    ("run `steerd collect --plan mixed`", "run `steerd collect --plan mixed`"),
])  # fmt: skip
def test_errors_speak_of_arguments(said, shown_as):
    @speaking_of_arguments
    def refuse():
        raise SteerdError(said, said)

    with pytest.raises(SteerdError) as refused:
        refuse()
    assert (refused.value.what, refused.value.hint) == (shown_as, shown_as)


def test_outside_a_notebook_progress_shows_nothing(capfd):
    with notebook_progress("driving", 2.0) as move:
        move(1.0, "half")
    assert capfd.readouterr() == ("", "")
