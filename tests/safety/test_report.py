"""The matrix in slices: a cell that was kept is read and not driven again."""

import json
from dataclasses import asdict, replace
from math import inf

from tests.safety import report
from tests.safety.matrix import Outcome

CELLS = [("M1", "P5"), ("M1", "P6"), ("C9", "P5")]


def make_outcome(cell: tuple[str, str]) -> Outcome:
    return Outcome(*cell, inf, 0.25, 0.5, 0.01, ("FAULT_STOP",), "W1", ("W1", "W5"), ())


def test_the_matrix_goes_on_where_it_was_left(monkeypatch, tmp_path) -> None:
    driven = []

    def drive(cell: tuple[str, str]) -> Outcome:
        driven.append(cell)
        return make_outcome(cell)

    monkeypatch.setattr(report, "list_cells", lambda: CELLS)
    monkeypatch.setattr(report, "run_named", drive)
    keep = tmp_path / "cells.jsonl"
    known = {**asdict(make_outcome(CELLS[1])), "wall": 3.1}
    keep.write_text(json.dumps(known) + "\n")
    assert report.drive_matrix(keep, 1) == [make_outcome(cell) for cell in CELLS]
    assert driven == [CELLS[0], CELLS[2]]
    assert report.drive_matrix(keep, 1) == [make_outcome(cell) for cell in CELLS]
    assert len(driven) == 2, "all of them are kept now"
    report.drive_matrix(None, 1)
    assert len(driven) == 5, "without a file every cell is driven"


def test_the_table_shows_the_slowest_stop_the_longest_way_and_what_failed() -> None:
    stopped = replace(make_outcome(("M1", "P5")), stop_s=0.16, distance_m=0.8)
    late = replace(stopped, phase="P6", stop_s=0.4, distance_m=0.5, wrong=("late",))
    quiet = make_outcome(("M17", "P5"))
    table = "\n".join(report.write_matrix([stopped, late, quiet]))
    assert "| M1 silence **P6: late** | FAULT_STOP 150 | 400 | 0.80 |" in table
    assert "M17 5 % random loss," in table.splitlines()[-1]
    assert "3 cells, 2 good" in table
