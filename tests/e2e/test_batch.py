"""`steerd batch` and `steerd.batch`: rows of many sessions, what changed and since when."""

import os
import shutil
from pathlib import Path

import polars
import pytest

import steerd
from benchmarks.batch_drives import Hidden, make_fleet
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode

pytestmark = pytest.mark.slow
GOLDEN = Path(__file__).resolve().parents[1] / "golden"
DAYS, CHANGED = 9, 5


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Two cars over nine days; on the sixth somebody bends the steering of the second."""
    folder = tmp_path_factory.mktemp("fleet")
    make_fleet(folder, 2, DAYS, (Hidden("car2", "steer_bias", CHANGED, 0.02),))
    return folder


@pytest.fixture
def drives(tmp_path):
    """Recorded drives on days of their own, one of them no session."""
    folder = tmp_path / "drives"
    folder.mkdir()
    for number, path in enumerate(sorted(GOLDEN.glob("*.mcap"))):
        copy = folder / path.name
        shutil.copyfile(path, copy)
        os.utime(copy, ns=(0, 1_772_366_400_000_000_000 + number * 86_400_000_000_000))
    (folder / "junk.mcap").write_text("junk")
    return folder


def test_the_car_and_the_day_of_a_change_are_found(fleet, tmp_path):
    out = tmp_path / "cars.parquet"
    found = steerd.batch("identify", fleet, output=out, jobs=1)
    assert {row["outcome"] for row in found.rows} == {"done"}
    first = found.changes[0]
    assert (first.car, first.quantity, first.day) == ("car2", "steer_bias", "2026-03-06")
    assert first.after - first.before == pytest.approx(0.02, abs=0.004)
    assert {change.car for change in found.changes} == {"car2"}
    assert "car2 since 2026-03-06" in found.render_report()
    table = polars.read_parquet(out)
    assert table.height == 2 * DAYS
    assert table["steer_bias_sd"].null_count() == 0
    assert table["day"][0] == "2026-03-01"
    again = steerd.batch("identify", fleet, output=out, jobs=1)
    assert again.worked == 0, "the same question of the same sessions is not asked twice"
    assert again.encode_table() == out.read_bytes()


def test_a_failed_session_is_a_row_and_the_next_start_tries_it_again(drives, tmp_path, capsys):
    out, page = tmp_path / "t.parquet", tmp_path / "t.html"
    argv = ["batch", "summarise", str(drives), "-o", str(out), "--page", str(page), "--jobs", "1"]
    assert run_cli(argv) == ExitCode.OK
    screen = capsys.readouterr().out
    assert "7 of 1 car, 2026-03-01 to" in screen
    assert "junk.mcap is not an MCAP file" in " ".join(screen.split())
    assert max(map(len, screen.splitlines())) <= 80
    table = polars.read_parquet(out)
    by_name = {Path(row["session"]).stem: row for row in table.iter_rows(named=True)}
    assert by_name["junk"]["outcome"] == "failed"
    assert by_name["circle"]["day"] == "2026-03-01", "virtual time has no date: the file's"
    assert by_name["circle"]["seconds"] > 1.0
    assert "junk.mcap is not an MCAP file" in page.read_text()
    shutil.copyfile(drives / "circle.mcap", drives / "junk.mcap")
    assert run_cli(argv) == ExitCode.OK
    assert "1 worked on now" in capsys.readouterr().out
    assert polars.read_parquet(out)["outcome"].to_list() == ["done"] * 7


def test_a_session_is_diagnosed_with_its_cars_own_file(fleet, tmp_path):
    folder = tmp_path / "some"
    folder.mkdir()
    shutil.copyfile(fleet / "car2" / "day08.mcap", folder / "late.mcap")
    fit = steerd.identify(fleet / "car2" / "day00.mcap", wheelbase=0.3302)
    (tmp_path / "cars").mkdir()
    fit.save_car(tmp_path / "cars" / "car2.toml")
    (row,) = steerd.batch("diagnose", folder, cars=tmp_path / "cars", jobs=1).rows
    assert row["outcome"] == "done", row["failure"]
    assert row["car"] == "car2"
    assert row["gap"] > row["gap_after"] * 0.99


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["summarise", "{tmp}"], 3, "no session"),
        (["identify", "{drives}", "--cars", "{tmp}/none"], 3, "does not exist"),
        (["summarise", "{drives}", "-o", "{drives}/circle.mcap"], 2, "never overwritten"),
    ],
)
def test_a_mistake_is_one_line(words, code, said, drives, tmp_path_factory, capsys):
    empty = tmp_path_factory.mktemp("empty")
    argv = [word.format(tmp=empty, drives=drives) for word in words]
    assert run_cli(["batch", *argv]) == code
    assert said in capsys.readouterr().err
