"""A batch: what it takes, and steps in series of estimates, found on their day or not at all."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.batch import changes, run
from steerd.daemon.many.job import RowTable


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
    assert names(run.find_batch([str(folder)]), folder) == every
    assert names(run.find_batch([f"{folder}/**/*.mcap", str(folder / "a")]), folder) == every
    assert names(run.find_batch([f"{folder}/a/*"]), folder) == ["a/one.mcap"]
    assert names(run.find_batch([str(folder / "three.mcap")]), folder) == ["three.mcap"]


@pytest.mark.parametrize("word", ["none", "none/*.mcap", "a/b/*.txt"])
def test_a_word_that_names_nothing_is_refused(folder, word, monkeypatch):
    monkeypatch.chdir(folder)
    with pytest.raises(SteerdError) as caught:
        run.find_batch(["three.mcap", word])
    assert caught.value.code is ExitCode.UNREADABLE
    assert word in caught.value.what


def test_car_files_are_found_by_name_and_a_folder_without_one_is_refused(tmp_path):
    with pytest.raises(SteerdError, match="no car file"):
        run.read_cars(tmp_path)
    text = default_car_path().read_text()
    (tmp_path / "red.toml").write_text(text)
    (tmp_path / "blue.toml").write_text(text.replace("mass = 3.74", "mass = 3.9"))
    cars = run.read_cars(tmp_path)
    assert set(cars) == {"red", "blue"}
    assert cars["red"] != cars["blue"]
    assert run.read_cars(tmp_path / "red.toml") == {"": cars["red"]}
    assert run.read_cars(None) == {}
    (tmp_path / "odd.toml").write_text("[car]\nmass = 'heavy'\n")
    with pytest.raises(SteerdError, match="mass"):
        run.read_cars(tmp_path)


def test_a_file_that_was_written_since_is_another_unit_and_is_read_when_it_is_shipped(folder):
    path = folder / "three.mcap"
    (before,) = run.make_tasks([path])
    os.utime(path, ns=(0, 5))
    (after,) = run.make_tasks([path])
    assert before != after
    assert run.make_tasks([path])[after].changed_ns == 5
    assert run.read_content(run.UnitTask(path, 1)).content == path.read_bytes()
    assert run.read_content(run.UnitTask(Path("gone.mcap"), 1)).content is None


def test_rows_depend_on_the_question_and_the_cars():
    car = load_car(default_car_path())
    one = run.Question("identify", {"red": car})
    assert one.digest() == run.Question("identify", {"red": car}).digest()
    changed = (replace(car, text="y"), replace(car, posterior="y"))
    others = [run.Question("identify", {"red": each}) for each in changed]
    others.append(run.Question("diagnose", {"red": car}))
    assert len({one.digest(), *(other.digest() for other in others)}) == 4


DAY, BEGIN = 86_400.0, 1_772_366_400.0


def make_series(rng, count=30, at=None, step=0.0, sd=0.02, extra=0.0, car="a", name="x"):
    value = 1.0 + rng.normal(0.0, np.hypot(sd, extra), count)
    if at is not None:
        value[at:] += step
    return changes.Series(car, name, BEGIN + DAY * np.arange(count), value, np.full(count, sd))


def test_a_step_is_found_on_its_day():
    rng, off = np.random.default_rng(1), []
    for _ in range(50):
        (found,) = changes.find_changes([make_series(rng, at=12, step=0.12, extra=0.02)])
        off.append(int(found.day[-2:]) - 13)
        assert found.earliest <= found.day <= found.latest
        assert found.after - found.before == pytest.approx(0.12, abs=0.05)
        assert found.sigmas > 4.0
    assert np.mean(np.abs(off) <= 1) > 0.95


def test_a_change_within_a_day_has_a_page_and_a_line():
    row = {"session": "s", "car": "a", "outcome": "done"}
    rows = [row | {"start": BEGIN + i, "x": float(i > 5)} for i in range(12)]
    found = run.Batch(RowTable(rows), 12, 0.0, "identify")
    assert [card.figure for card in found.cards] == ["12", "x"]
    assert "x" in found.render_report()
    assert repr(found.rows) == "<12 rows of session, car, outcome, start, x>"


def make_quiet(rng):
    return [make_series(rng, extra=0.03) for _ in range(5)]


def make_too_sure(rng):
    """Five drives are sure of another value."""
    series = make_series(rng)
    odd = rng.choice(30, 5, replace=False)
    series.value[odd], series.sd[odd] = 1.04 + rng.normal(0.0, 0.002, 5), 0.002
    return [series]


def make_tailed(rng):
    """Log-normal, as prediction errors are, without stated errors: a tail is no step."""
    return [replace(make_series(rng, sd=0.0), value=rng.lognormal(-6.5, 0.6, 30))]


def make_mixed(rng):
    """Surer drives of another level, here and there."""
    series = make_two_models(rng, 15, 0.0)
    order = np.lexsort((rng.random(30), np.arange(30) // rng.integers(3, 30)))
    return [replace(series, value=series.value[order], sd=series.sd[order])]


@pytest.mark.parametrize(
    ("make", "most"), [(make_quiet, 6), (make_too_sure, 3), (make_tailed, 3), (make_mixed, 2)]
)
def test_where_nothing_changed_a_step_is_found_rarely(make, most):
    rng = np.random.default_rng(2)
    wrong = sum(bool(changes.find_changes(make(rng))) for _ in range(300))
    assert wrong <= most, f"{wrong} of 300 batches, at a bound of {changes.CHANCE}"


def make_two_models(rng, at, step):
    """Every third drive is twenty times as sure, of a value that lies a little higher."""
    series = make_series(rng, at=at, step=step)
    surer = np.arange(30) % 3 == 0
    series.value[surer] = 1.03 + rng.normal(0.0, 0.001, 10) + step * (np.flatnonzero(surer) >= at)
    series.sd[surer] = 0.001
    return series


def test_a_step_that_only_surer_drives_see_is_found():
    rng = np.random.default_rng(10)
    for _ in range(20):
        (found,) = changes.find_changes([make_two_models(rng, 15, 0.015)])
        assert found.earliest <= "2026-03-16" <= found.latest
        assert found.after - found.before == pytest.approx(0.015, abs=0.004)


def test_the_clearest_comes_first_and_carries_its_names():
    rng = np.random.default_rng(3)
    a, b = make_series(rng, at=10, step=0.1), make_series(rng, at=20, step=0.4, car="b", name="y")
    found = changes.find_changes([a, b, make_series(rng, car="c")])
    assert [(c.car, c.quantity) for c in found] == [("b", "y"), ("a", "x")]
    assert found[0].day == "2026-03-21"


def test_series_are_a_cars_own_in_the_order_of_time_and_few_drives_say_nothing():
    rows = [
        {"car": car, "start": BEGIN + DAY * day, "session": f"{car}{day}", "x": day, "x_sd": 0.1}
        for day in (3, 1, 0, 2, 5, 4) for car in ("b", "a")
    ]  # fmt: skip
    rows.append({"car": None, "start": None, "session": "broken"})
    one, two = changes.list_series(rows, ("x",))
    assert (one.car, two.car) == ("a", "b")
    np.testing.assert_array_equal(one.value, range(6))
    np.testing.assert_array_equal(one.sd, [0.1] * 6)
    day = {"car": "a", "session": "s", "x": 0.0}
    rows = [day | {"start": BEGIN + DAY * i} for i in range(changes.LEAST)]
    assert list(changes.list_series(rows[:-1], ("x",))) == []
    assert len(list(changes.list_series(rows, ("x", "y")))) == 1


def test_a_band_mixes_no_drives_from_before_and_after_a_change():
    series = make_series(np.random.default_rng(6), 14, at=9, step=3.0)
    before, after = map(changes.make_band, changes.split_series(series, BEGIN + 9 * DAY))
    assert before.mean.max() < 1.5
    assert after.mean.min() > 3.5
    alone, _ = changes.split_series(series, BEGIN + DAY)
    assert changes.make_band(alone).mean == pytest.approx(alone.value)


def test_bands_are_weekly_means():
    series = make_series(np.random.default_rng(5), 28, sd=0.02)
    band = changes.make_band(series)
    assert len(band.mean) == 4
    assert np.diff(band.start) == pytest.approx(changes.WEEK)
    assert band.mean[0] == pytest.approx(series.value[:7].mean(), abs=1e-9)
    assert 1.96 * 0.02 / np.sqrt(7) <= band.half[0] < 0.05


@pytest.mark.parametrize(("count", "told"), [(0, "no car has the 6 drives"), (3, "in 3 series")])
def test_why_no_change_is_named(count, told):
    assert told in changes.nothing_changed(count)
