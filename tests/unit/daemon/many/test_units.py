"""Work units: failures are results, workers may die, a cluster does the same."""

import math
import os
import signal
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import polars
import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.job import Column, Found, Job, do_job, finished_path, open_finished
from steerd.daemon.many.units import TRIES, Where, run_units


def work(about):
    """Does what it is told: `(what, file)`; the file counts the tries."""
    what, file = about
    with Path(file).open("ab") as out:
        out.write(b"x")
    tries = Path(file).stat().st_size
    if what == "refuse":
        raise SteerdError("no such car")
    if what == "break":
        raise ZeroDivisionError("in a unit")
    if what == "disk" or (what == "disk once" and tries == 1):
        raise OSError(5, "Input/output error")
    if what == "die" or (what == "die once" and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"tries": tries}


def run(tmp_path, where, *kinds):
    todo = {f"{i} {kind}": (kind, str(tmp_path / str(i))) for i, kind in enumerate(kinds)}
    return {done.unit: done for done in run_units(work, todo, where)}


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_failed_unit_is_a_result_and_no_end(tmp_path, jobs):
    found = run(tmp_path, Where(jobs), "good", "refuse", "break", "disk", "disk once", "good")
    assert len(found) == 6
    good, refused, broken, disk, once = (found[name] for name in sorted(found)[:5])
    assert good.row == {"tries": 1}
    assert (refused.failure, refused.tries) == ("no such car", 1), "refused once, refused again"
    assert broken.failure == "ZeroDivisionError: in a unit"
    assert disk.tries == TRIES
    assert "Input/output" in disk.failure
    assert (once.row, once.tries) == ({"tries": 2}, 2)


@pytest.mark.slow
def test_a_worker_that_dies_takes_nobody_along(tmp_path):
    found = run(tmp_path, Where(2), "good", "die", "die once", *["good"] * 5)
    assert len(found) == 8
    assert {name for name, done in found.items() if done.row is None} == {"1 die"}
    assert found["1 die"].failure == "its worker died each time"
    assert found["1 die"].tries == TRIES


def test_numbers_of_processes():
    assert (Where(3).processes, Where().processes) == (3, len(os.sched_getaffinity(0)))
    with pytest.raises(SteerdError, match="--jobs -1") as caught:
        Where(-1)
    assert caught.value.code is ExitCode.USAGE


# --- a cluster
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same_results_and_survives_a_worker(tmp_path):
    """With a real scheduler and two worker processes on loopback."""
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    kinds = ("good", "refuse", "break", "disk once", "die once", *["good"] * 12)
    with distributed.LocalCluster(**options, host="127.0.0.1") as cluster:
        found = run(tmp_path, Where(dask=cluster.scheduler_address), *kinds)
    assert len(found) == len(kinds)
    assert {n for n, done in found.items() if done.row is None} == {"1 refuse", "2 break"}
    assert found["1 refuse"].failure == "no such car"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    monkeypatch.setattr("steerd.daemon.many.units._ANSWER", "200ms")
    with pytest.raises(SteerdError, match=r"--dask tcp://127\.0\.0\.1:9") as caught:
        run(tmp_path, Where(dask="tcp://127.0.0.1:9"), "good")
    assert caught.value.code is ExitCode.UNREACHABLE


# What an interrupted command had finished is found again, whole.
UNITS = {"a": {"x": 0.1 + 0.2, "y": None}, "b": {"x": 1e-300, "y": "wörds"}}
Rows = namedtuple("Rows", "rows worked wall")
output = pytest.fixture(lambda tmp_path: tmp_path / "out.parquet")


def do(output, basis="p", stop=None, units=UNITS):
    def make_row(done):
        if done.unit == stop:
            raise KeyboardInterrupt
        return {"outcome": "done", **done.row}

    return do_job(Job("", lambda row: row, units, basis, make_row, Rows), Where(1), output)


def test_rows_come_back_digit_by_digit_and_are_not_made_again(output):
    first = do(output)
    again = do(output, units={**UNITS, "c": {"x": float("inf")}})
    assert again.rows == (*first.rows, {"outcome": "done", "x": float("inf")})
    assert (first.worked, again.worked) == (2, 1)


def test_ctrl_c_says_that_the_command_goes_on_where_it_was(output, capsys):
    with pytest.raises(KeyboardInterrupt):
        do(output, stop="b")
    assert str(finished_path(output)) in capsys.readouterr().err
    assert do(output).worked == 1
    with pytest.raises(KeyboardInterrupt):
        do(None, stop="b")
    assert capsys.readouterr().err == ""


def test_what_a_killed_command_had_finished_is_there(output):
    child = os.fork()
    if child == 0:
        with open_finished(finished_path(output), "p") as (_, keep):
            keep("a", "p", {"outcome": "done", "x": 1})
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    found = do(output)
    assert found.worked == 1
    assert found.rows[0]["x"] == 1


@pytest.mark.parametrize("text", ["a note of mine\n", "x" * 5000])
def test_another_ones_file_is_refused_and_stays(output, text):
    finished_path(output).write_text(text)
    with pytest.raises(SteerdError, match="no finished rows of steerd") as caught:
        do(output)
    assert caught.value.code is ExitCode.USAGE
    assert finished_path(output).read_text() == text


def test_rows_of_other_work_are_refused_and_stay(output):
    do(output, "other")
    with pytest.raises(SteerdError, match="another command") as caught:
        do(output)
    assert caught.value.code is ExitCode.USAGE
    assert do(output, "other").worked == 0


def test_two_commands_do_not_write_one_table(output):
    writing = pytest.raises(SteerdError, match="another command is writing")
    with open_finished(finished_path(output), "p"), writing:
        do(output)


# Parquet files: values and units come back, the same rows are the same bytes.
COLUMNS = (
    Column("speed", "number", "m/s", "how fast"), Column("count", "count", "", "how often"),
    Column("name", "text", "", "which"),
)  # fmt: skip
MIXED_ROWS = (
    {"speed": 0.1 + 0.2, "count": 3, "name": "a"},
    {"speed": math.nan, "name": None},
    {"speed": -math.inf, "count": 2**60, "name": "ü", "other": 1},
)


def read(rows):
    """The parquet file of these rows."""
    return polars.read_parquet(Found.encode_table(SimpleNamespace(columns=COLUMNS, rows=rows)))


def test_values_come_back_and_what_is_missing_is_missing():
    first, second, third = read(MIXED_ROWS).to_dicts()
    assert first == MIXED_ROWS[0]
    assert second == {"speed": None, "count": None, "name": None}
    assert third == {"speed": -math.inf, "count": 2**60, "name": "ü"}
    assert read(()).columns == [column.name for column in COLUMNS], "an empty table has its columns"
