"""Rows of a csv file: delimiter, header, cells and their errors."""

import pytest

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.imports.csv_table import open_table, read_table
from steerd.daemon.imports.import_map import ColumnSpec

COLUMNS = {"t": ColumnSpec("time"), "x": ColumnSpec("pos x", scale=0.001, offset=1.0)}


def rows(path, columns=COLUMNS):
    with open_table(path) as file:
        return [(row.number, row.values) for row in read_table(path.name, file, columns, _ignore)]


def _ignore(done):
    pass


def write(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path


def test_rows_are_numbered_as_an_editor_numbers_lines(tmp_path):
    text = "\n# time,pos x\n0.0,1\n\n0.1,\nnan,null\n0.2,3\n"
    assert [number for number, _ in rows(write(tmp_path, text))] == [3, 5, 7]


def test_a_missing_column_has_the_closest_names_as_its_hint(tmp_path):
    with pytest.raises(SteerdError) as caught:
        rows(write(tmp_path, "time,Pos X,speed\n0.0,1,2\n"))
    assert caught.value.hint == "in the map, 'Pos X'"
