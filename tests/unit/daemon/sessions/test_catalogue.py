"""The list of drives: order, figures, what is remembered, and what people wrote."""

import json
import os
import shutil
import sqlite3
from pathlib import Path

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.sessions import catalogue

GOLDEN = Path(__file__).resolve().parents[3] / "golden"
DAY_NS = 86_400_000_000_000
NOON_NS = 1_700_000_000_000_000_000


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Three drives, one a day; an index and a data folder of their own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    place = tmp_path / "drives"
    place.mkdir()
    for number, name in enumerate(("circle.mcap", "estop.mcap", "straight.mcap")):
        path = shutil.copyfile(GOLDEN / name, place / name)
        os.utime(path, ns=(0, NOON_NS + number * DAY_NS))
    monkeypatch.chdir(place)
    return place


def by_name(folder):
    return {e.path.stem: e for e in catalogue.list_entries(catalogue.find_sessions([folder]))}


def test_the_drive_that_ended_last_comes_first(folder):
    stems = [path.stem for path in catalogue.find_sessions([folder])]
    assert stems == ["straight", "estop", "circle"]
    for word, stem in (("@last", "straight"), ("@-1", "straight"), ("@-3", "circle")):
        assert catalogue.find_session(word).stem == stem
    assert catalogue.find_session("other.mcap") == Path("other.mcap")


@pytest.mark.parametrize("word", ["@", "@first", "@-0", "@-x", "@3", "@-4"])
def test_a_word_that_names_no_place_is_refused(folder, word):
    few = word == "@-4"
    with pytest.raises(SteerdError, match="3 sessions in" if few else "no such") as caught:
        catalogue.find_session(word)
    assert caught.value.code == (ExitCode.UNREADABLE if few else ExitCode.USAGE)


def test_figures_come_from_the_files_and_one_that_is_no_session_is_listed_as_such(folder):
    (folder / "broken.mcap").write_bytes(b"hello")
    found = by_name(folder)
    assert found["broken"].verdict.startswith("unreadable")
    assert found["circle"].verdict == "ok"
    assert found["circle"].lane.startswith("circle")
    assert 0.0 < found["circle"].metres < 100.0
    assert found["estop"].verdict != "ok"


def test_a_file_is_read_once_and_again_when_it_has_changed(folder, monkeypatch):
    first, read, summarise = by_name(folder), [], catalogue.summarise
    monkeypatch.setattr(catalogue, "summarise", lambda path: read.append(path) or summarise(path))
    assert by_name(folder) == first
    assert read == []
    os.utime(folder / "circle.mcap", ns=(0, NOON_NS + 9 * DAY_NS))
    assert by_name(folder)["circle"].metres == first["circle"].metres
    assert [path.stem for path in read] == ["circle"]


@pytest.mark.parametrize("damage", ["delete", "garbage", "old", "folder"])
def test_the_index_can_be_thrown_away(folder, damage):
    first, file = by_name(folder), catalogue.index_file()
    if damage == "old":
        with sqlite3.connect(file) as index:
            index.execute("UPDATE rows SET row = '{\"unknown\": 1}'")
        index.close()
    else:
        file.unlink()
    if damage == "garbage":
        file.write_bytes(b"no database " * 1000)
    if damage == "folder":
        file.mkdir()
    assert by_name(folder) == first


def test_tags_and_notes_go_where_the_file_goes(folder):
    catalogue.write_notes(folder / "circle.mcap", ["wet", "new", "wet"], 'tyre "B"')
    assert catalogue.read_notes(folder / "circle.mcap") == (("wet", "new"), 'tyre "B"')
    entry = by_name(folder)["circle"]
    assert (entry.tags, entry.note) == (("wet", "new"), 'tyre "B"')
    (folder / "circle.notes.toml").write_text("tags = 3 [")
    assert catalogue.read_notes(folder / "circle.mcap") == ((), "")


def test_the_command_lists_tags_and_filters(folder, cli):
    cli("sessions", "tag", "@-3", "wet")
    cli("sessions", "note", "@last", "left tyre", "changed")
    text = cli("sessions").out
    lines = text.splitlines()
    assert max(map(len, lines)) <= 80
    assert text.index("@last") < text.index("left tyre changed") < text.index("@-2")
    assert "#wet" in lines[-1]
    (only,) = json.loads(cli("sessions", "--tag", "wet", "--json").out)["sessions"]
    assert Path(only["path"]).stem == "circle"
    cli("sessions", "untag", "@-3", "wet")
    cli("sessions", "--folder", "nowhere", code=ExitCode.UNREADABLE)


def test_the_page_leads_to_each_drives_page_from_wherever_it_lies(folder, tmp_path, cli):
    (folder / "circle.mcap").rename(folder / "a #1 <b>.mcap")
    (folder / "a #1 <b>.html").write_text("")
    catalogue.write_notes(folder / "estop.mcap", ["wet"], "")
    assert "sessions.html: 3 drives" in cli("sessions", "--folder", ".", "--page").out
    page = (folder / "sessions.html").read_text(encoding="utf-8")
    assert '<a href="a%20%231%20%3Cb%3E.html">a #1 &lt;b&gt;</a>' in page
    assert page.count("<a ") == 1
    assert "emergency stop called · #wet" in page
    cli("sessions", "--page", tmp_path / "all.html")
    assert 'href="drives/a%20' in (tmp_path / "all.html").read_text(encoding="utf-8")
    cli("sessions", "--page", folder, code=ExitCode.UNREADABLE)


def test_a_command_without_a_session_takes_the_last_one_and_says_so(folder, cli):
    said = cli("info")
    assert said.out.startswith("straight.mcap")
    assert "session: " in said.err
    assert cli("info", "@-3").out.startswith("circle.mcap")
