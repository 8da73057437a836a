"""What a command writes replaces what steerd wrote before; anything else is kept beside it."""

import os
import sys
import time

import pytest

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.written import check_outputs, write_output, write_outputs


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
