"""`steerd sweep` and `steerd.sweep`: a table, a page, going on after Ctrl-C, the same bytes."""

import json

import polars
import pytest

import steerd
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode
from steerd.steer_bus.session_read import open_session

VARY = {"effect.steer_delay": {"low": 0.0, "high": 0.05}, "car.mass": [3.0, 4.5]}
TEXT = """
seeds = 2
duration = 3.6
[vary]
"effect.steer_delay" = { low = 0.0, high = 0.05 }
"car.mass" = [3.0, 4.5]
"""
pytestmark = pytest.mark.slow


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The table of the sweep, driven in one piece in this process."""
    path = tmp_path_factory.mktemp("whole") / "whole.parquet"
    found = steerd.sweep(VARY, seeds=2, duration=3.6, jobs=1, output=path)
    assert len(found.rows) == 4
    return path.read_bytes()


def test_a_sweep_is_a_table_and_a_page(file, tmp_path, whole, capsys):
    out, page = tmp_path / "t.parquet", tmp_path / "t.html"
    argv = ["sweep", str(file), "-o", str(out), "--page", str(page), "--jobs", "2"]
    assert run_cli(argv) == ExitCode.OK
    screen = capsys.readouterr().out
    assert "4 of 3.6 s" in screen
    assert max(map(len, screen.splitlines())) <= 80
    assert out.read_bytes() == whole, "processes and files give the bytes of the API"
    table = polars.read_parquet(out)
    assert table["drive"].to_list() == [0, 1, 2, 3]
    assert table["car.mass"].to_list() == [3.0, 3.0, 4.5, 4.5]
    assert table["outcome"].to_list() == ["driven"] * 4
    assert table["true_e1_max"].null_count() == 0
    text = page.read_text()
    assert "4 drives, each another draw" in text
    assert "http" not in text.replace("http://www.w3.org", "")
    assert not out.with_name("t.parquet.journal").exists()


def test_a_drive_of_it_is_driven_again_and_recorded(file, tmp_path, whole, capsys):
    (tmp_path / "whole.parquet").write_bytes(whole)
    row = polars.read_parquet(tmp_path / "whole.parquet").row(3, named=True)
    session = tmp_path / "again.mcap"
    assert run_cli(["sweep", str(file), "--again", "3", "--record", str(session)]) == 0
    said = capsys.readouterr().out
    assert f"effect.steer_delay {row['effect.steer_delay']:.4g}" in said
    truth = open_session(session).info().metadata
    assert json.loads(truth["steerd.session"]["options"])["seed"] == row["seed"]
    assert float(truth["steerd.truth"]["mass"]) == row["car.mass"], "the car that drove"
    drive = steerd.load(session)
    assert drive.duration > 3.6


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 2, "a sweep file is needed"),
        (["{file}", "--again", "3"], 2, "--again and --record go together"),
        (["{file}", "--again", "9", "--record", "x.mcap"], 2, "they are 0 to 3"),
        (["{file}", "-o", "{tmp}/none/x.parquet"], 3, "there is no folder"),
    ],
)
def test_a_mistake_is_one_line(words, code, said, file, tmp_path, capsys):
    argv = [word.format(file=file, tmp=tmp_path) for word in words]
    assert run_cli(["sweep", *argv]) == code
    assert said in capsys.readouterr().err


def test_the_example_is_a_sweep_file(tmp_path, capsys):
    assert run_cli(["sweep", "--example"]) == 0
    path = tmp_path / "example.toml"
    path.write_text(capsys.readouterr().out.replace("200", "1").replace("20.0", "0.3"))
    assert run_cli(["sweep", str(path), "--jobs", "1"]) == 0
    assert "2 of 0.3 s" in capsys.readouterr().out
