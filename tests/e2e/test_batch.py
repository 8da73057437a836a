"""Many drives: `steerd batch` and `steerd sweep`, their tables, pages and mistakes."""

import json
import os
import shutil
import tomllib
from pathlib import Path

import polars
import pytest

import steerd
from benchmarks.batch_drives import Hidden, make_fleet
from steerd.steer_bus.session_read import open_session

pytestmark = pytest.mark.slow
GOLDEN = Path(__file__).resolve().parents[1] / "golden"
DAYS, CHANGED = 6, 3


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Two cars over six days; on the fourth somebody bends the steering of the second."""
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
    assert (first.car, first.quantity, first.day) == ("car2", "steer_bias", "2026-03-04")
    assert first.after - first.before == pytest.approx(0.02, abs=0.004)
    assert {change.car for change in found.changes} == {"car2"}
    assert "car2 since 2026-03-04" in found.render_report()
    table = polars.read_parquet(out)
    assert (table.height, table["steer_bias_sd"].null_count()) == (2 * DAYS, 0)
    assert table["day"][0] == "2026-03-01"
    again = steerd.batch("identify", fleet, output=out, jobs=1)
    assert again.worked == 0, "the same question of the same sessions is not asked twice"
    assert again.encode_table() == out.read_bytes()


def test_a_failed_session_is_a_row_and_the_next_start_tries_it_again(drives, tmp_path, cli):
    out, page = tmp_path / "t.parquet", tmp_path / "t.html"
    argv = ["batch", "summarise", drives, "-o", out, "--page", page, "--jobs", 1]
    screen = cli(*argv).out
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
    assert "1 worked on now" in cli(*argv).out
    assert polars.read_parquet(out)["outcome"].to_list() == ["done"] * 7


def test_a_session_is_diagnosed_with_its_cars_own_file(fleet, tmp_path):
    folder = tmp_path / "some"
    folder.mkdir()
    shutil.copyfile(fleet / "car2" / "day05.mcap", folder / "late.mcap")
    fit = steerd.identify(fleet / "car2" / "day00.mcap", wheelbase=0.3302)
    (tmp_path / "cars").mkdir()
    fit.save_car(tmp_path / "cars" / "car2.toml")
    (row,) = steerd.batch("diagnose", folder, cars=tmp_path / "cars", jobs=1).rows
    assert row["outcome"] == "done", row["failure"]
    assert row["car"] == "car2"
    assert row["gap"] > row["gap_after"] * 0.99


# `steerd sweep` and `steerd.sweep`: a table, a page, going on after Ctrl-C, the same bytes.
TEXT = """
seeds = 2
duration = 3.6
[vary]
"effect.steer_delay" = { low = 0.0, high = 0.05 }
"car.mass" = [3.0, 4.5]
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The table of the sweep, driven in one piece in this process."""
    path = tmp_path_factory.mktemp("whole") / "whole.parquet"
    found = steerd.sweep(tomllib.loads(TEXT)["vary"], seeds=2, duration=3.6, jobs=1, output=path)
    assert len(found.rows) == 4
    return path.read_bytes()


def test_a_sweep_is_a_table_and_a_page(file, tmp_path, whole, cli):
    out, page = tmp_path / "t.parquet", tmp_path / "t.html"
    screen = cli("sweep", file, "-o", out, "--page", page, "--jobs", 2).out
    assert "4 of 3.6 s" in screen
    assert max(map(len, screen.splitlines())) <= 80
    assert out.read_bytes() == whole, "processes and files give the bytes of the API"
    table = polars.read_parquet(out)
    assert table["drive"].to_list() == [0, 1, 2, 3]
    assert table["car.mass"].to_list() == [3.0, 3.0, 4.5, 4.5]
    assert (table["outcome"].to_list(), table["true_e1_max"].null_count()) == (["driven"] * 4, 0)
    text = page.read_text()
    assert "4 drives, each another draw" in text
    assert "http" not in text.replace("http://www.w3.org", "")
    assert not out.with_name("t.parquet.journal").exists()


def test_a_drive_of_it_is_driven_again_and_recorded(file, tmp_path, whole, cli):
    (tmp_path / "whole.parquet").write_bytes(whole)
    row = polars.read_parquet(tmp_path / "whole.parquet").row(3, named=True)
    session = tmp_path / "again.mcap"
    said = cli("sweep", file, "--again", "3", "--record", session).out
    assert f"effect.steer_delay {row['effect.steer_delay']:.4g}" in said
    truth = open_session(session).info().metadata
    assert json.loads(truth["steerd.session"]["options"])["seed"] == row["seed"]
    assert float(truth["steerd.truth"]["mass"]) == row["car.mass"], "the car that drove"
    drive = steerd.load(session)
    assert drive.duration > 3.6


def test_the_example_is_a_sweep_file(tmp_path, cli):
    path, text = tmp_path / "example.toml", cli("sweep", "--example").out
    path.write_text(text.replace("200", "1").replace("20.0", "0.3"))
    assert "2 of 0.3 s" in cli("sweep", path, "--jobs", "1").out
