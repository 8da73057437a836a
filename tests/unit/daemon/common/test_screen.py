"""Lines for a terminal, the bar of a long command, values in a notebook, and what is written."""

import io
import os
import shlex
import sys
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.daemon.common import screen
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.notebook import notebook_progress, speaking_of_arguments
from steerd.daemon.common.screen import clean, join_words, shown, watched, wrap, wrap_command
from steerd.daemon.common.written import check_outputs, write_output, write_outputs


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
    with screen.show_progress("identifying", 2.0) as advance:
        advance(1.0, "learning the noise")
    assert "identifying: learning the noise" in seen.getvalue()
    assert "50%" in seen.getvalue()


def test_items_are_counted_as_they_pass():
    seen: list[int] = []
    assert list(watched("abcdefg", seen.append, every=3)) == list("abcdefg")
    assert seen == [0, 3, 6]


# Values in a notebook: short inside others, the screen on their own.
@shown
class Screen(str):
    """A value whose screen is its text."""


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


# What a command writes replaces what steerd wrote before; anything else is kept beside it.
@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    place = tmp_path / "work"
    place.mkdir()
    return place


def date(path, seconds=1_700_000_000):
    os.utime(path, (seconds, seconds))


def names(place):
    return sorted(path.name for path in place.iterdir())


def test_what_steerd_wrote_is_replaced(state):
    path = state / "gap.html"
    for text in ("one", "two", "one"):
        assert write_output(path, text) is None
        assert path.read_text() == text
    path.write_text("by hand")
    assert write_output(path, "by hand") is None, "the same content needs no second file"
    assert names(state) == ["gap.html"]


@pytest.mark.parametrize("whose", ["ours", "ours, edited", "foreign"])
def test_a_car_file_is_kept_with_the_date_of_its_last_change_whoever_wrote_it(state, whose):
    path, before = state / "car.toml", "mass = 3.0 # weighed\n"
    if whose != "foreign":
        assert write_output(path, before if whose == "ours" else "mass = 3.0\n") is None
    if whose != "ours":
        path.write_text(before)
    date(path)
    kept = write_output(path, "mass = 3.2\n")
    assert kept == state / "car.2023-11-14T22-13-20.toml"
    assert kept.read_text() == before
    assert path.read_text() == "mass = 3.2\n"
    path.write_text("again by hand")
    date(path)
    again = write_output(path, "mass = 3.3\n")
    assert again == state / "car.2023-11-14T22-13-20.2.toml"
    assert kept.read_text() == before


@pytest.mark.parametrize(("failing", "said"), [
    (["write_atomically"], "No space left"), (["os.link", "write_atomically"], "No space left"),
    (["os.link", "shutil.copy2"], "cannot be kept: No space left"),
])  # fmt: skip
def test_a_write_that_fails_leaves_everything_as_it_was(state, monkeypatch, failing, said):
    path = state / "car.toml"
    path.write_text("by hand")

    def refuse(*_):
        raise OSError(28, "No space left on device")

    for name in failing:
        monkeypatch.setattr(f"steerd.daemon.common.written.{name}", refuse)
    with pytest.raises(SteerdError, match=said):
        write_output(path, "new")
    assert (path.read_text(), names(state)) == ("by hand", ["car.toml"])


def test_without_a_state_folder_every_other_file_is_kept(state, tmp_path):
    (tmp_path / "state").write_text("no folder")
    write_output(state / "car.toml", "one")
    assert write_output(state / "car.toml", "two") is not None


def test_one_output_that_fails_does_not_take_the_others_along(state, capsys):
    (state / "car.toml").write_text("by hand")
    date(state / "car.toml")
    texts = {state / "none" / "report.html": "page", state / "car.toml": "car"}
    texts |= {None: "nobody asked", state / "gap.json": None}
    with pytest.raises(SteerdError, match=r"report\.html: No such file"):
        write_outputs(texts)
    assert (state / "car.toml").read_text() == "car"
    assert names(state) == ["car.2023-11-14T22-13-20.toml", "car.toml"]
    said = capsys.readouterr().err
    assert said.startswith(f"note: what {state / 'car.toml'} was before is kept as")
    assert "car.2023-11-14T22-13-20.toml" in said


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_is_told_what_was_written(terminal, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    page, car = tmp_path / "page.html", tmp_path / "car.toml"
    write_outputs({page: "a", None: "b", car: None}, announced=True)
    assert (str(page) in capsys.readouterr().err) is terminal
    write_outputs({page: "c"})
    assert capsys.readouterr().err == ""


def test_two_outputs_are_two_files_in_folders_that_take_them(tmp_path, monkeypatch):
    (tmp_path / "inner").mkdir()
    again = tmp_path / "inner" / ".." / "x"
    with pytest.raises(SteerdError, match="-o and --json name the same file"):
        check_outputs({"-o": tmp_path / "x", "--json": again, "--report": None})
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(SteerdError, match="cannot be written"):
        check_outputs({"-o": tmp_path / "car.toml"})
