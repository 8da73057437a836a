"""Folders, patterns and files; car files by the cars' names; what a session's row depends on."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.batch import unit


@pytest.fixture
def folder(tmp_path):
    for name in ("a/one.mcap", "a/b/two.mcap", "three.mcap", "a/notes.txt", "three.mcap.partial"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
    return tmp_path


def names(paths, folder):
    return [str(path.relative_to(folder)) for path in paths]


def test_folders_patterns_and_files_name_each_session_once(folder):
    every = ["a/b/two.mcap", "a/one.mcap", "three.mcap"]
    assert names(unit.find_batch([str(folder)]), folder) == every
    assert names(unit.find_batch([f"{folder}/**/*.mcap", str(folder / "a")]), folder) == every
    assert names(unit.find_batch([f"{folder}/a/*"]), folder) == ["a/one.mcap"]
    assert names(unit.find_batch([str(folder / "three.mcap")]), folder) == ["three.mcap"]


@pytest.mark.parametrize("word", ["none", "none/*.mcap", "a/b/*.txt"])
def test_a_word_that_names_nothing_is_refused(folder, word, monkeypatch):
    monkeypatch.chdir(folder)
    with pytest.raises(SteerdError) as caught:
        unit.find_batch(["three.mcap", word])
    assert caught.value.code is ExitCode.UNREADABLE
    assert word in caught.value.what


def test_car_files_are_found_by_name_and_a_folder_without_one_is_refused(tmp_path):
    with pytest.raises(SteerdError, match="no car file"):
        unit.read_cars(tmp_path)
    text = default_car_path().read_text()
    (tmp_path / "red.toml").write_text(text)
    (tmp_path / "blue.toml").write_text(text.replace("mass = 3.74", "mass = 3.9"))
    cars = unit.read_cars(tmp_path)
    assert set(cars) == {"red", "blue"}
    assert cars["red"] != cars["blue"]
    assert unit.read_cars(tmp_path / "red.toml") == {"": cars["red"]}
    assert unit.read_cars(None) == {}
    (tmp_path / "odd.toml").write_text("[car]\nmass = 'heavy'\n")
    with pytest.raises(SteerdError, match="mass"):
        unit.read_cars(tmp_path)


def test_a_file_that_was_written_since_is_another_unit_and_is_read_when_it_is_shipped(folder):
    path = folder / "three.mcap"
    (before,) = unit.make_tasks([path])
    os.utime(path, ns=(0, 5))
    (after,) = unit.make_tasks([path])
    assert before != after
    assert unit.make_tasks([path])[after].changed_ns == 5
    assert unit.read_content(unit.UnitTask(path, 1)).content == path.read_bytes()
    assert unit.read_content(unit.UnitTask(Path("gone.mcap"), 1)).content is None


def test_rows_depend_on_the_question_and_the_cars():
    car = load_car(default_car_path())
    one = unit.Question("identify", {"red": car})
    assert one.digest() == unit.Question("identify", {"red": car}).digest()
    changed = (replace(car, text="y"), replace(car, posterior="y"))
    others = [unit.Question("identify", {"red": each}) for each in changed]
    others.append(unit.Question("diagnose", {"red": car}))
    assert len({one.digest(), *(other.digest() for other in others)}) == 4
