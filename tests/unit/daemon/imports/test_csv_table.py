"""Rows of a csv file: delimiter, header, cells and their errors."""

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.imports.csv_table import LINE_MAX, open_table, read_table
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


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_the_delimiter_is_the_one_that_gives_the_mapped_names(tmp_path, delimiter):
    text = "\n".join(delimiter.join(cells) for cells in (("time", "pos x"), ("0.5", "2000")))
    assert rows(write(tmp_path, text)) == [(2, {"t": 0.5, "x": 3.0})]


def test_rows_are_numbered_as_an_editor_numbers_lines(tmp_path):
    text = "\n# time,pos x\n0.0,1\n\n0.1,\nnan,null\n0.2,3\n"
    assert [number for number, _ in rows(write(tmp_path, text))] == [3, 5, 7]


def test_a_gate_of_zero_gives_zero_and_another_one_the_value(tmp_path):
    columns = {"throttle": ColumnSpec("gas", scale=2.0, gate="on")}
    text = "gas,on\n0.3,0\n0.3,1\n0.3,\n"
    values = [row["throttle"] for _, row in rows(write(tmp_path, text), columns)]
    assert values == [0.0, 0.6, 0.0]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("time,pos x\n0.0,abc\n", "a.csv row 2, column 'pos x': 'abc' is not a number"),
        ("time,pos x\n0.0,inf\n", "row 2, column 'pos x': 'inf' is not a number"),
        ("time,pos x\n0.0,1e308\n0.1,1_0\n", "row 3, column 'pos x': '1_0' is not a number"),
        ("time,pos x\n0.0,1,7\n", "row 2: 3 cells under 2 column names"),
        ("time,pos x,pos x\n0.0,1,2\n", "has 2 columns named 'pos x'"),
        ("time,pos_x\n0.0,1\n", "has no column 'pos x'"),
        ("time,pos x\n" + "1" * (LINE_MAX + 1), f"row 2: more than {LINE_MAX} characters"),
        ("\n \n", "holds only blank lines"),
    ],
)
def test_an_error_names_its_place(tmp_path, text, what):
    with pytest.raises(SteerdError) as caught:
        rows(write(tmp_path, text))
    assert what in caught.value.what


def test_a_missing_column_has_the_closest_names_as_its_hint(tmp_path):
    with pytest.raises(SteerdError) as caught:
        rows(write(tmp_path, "time,Pos X,speed\n0.0,1,2\n"))
    assert caught.value.hint == "in the map, 'Pos X'"


@pytest.mark.parametrize(("content", "what"), [(None, "does not exist"), (b"", "is empty")])
def test_what_is_no_table_is_unreadable(tmp_path, content, what):
    path = tmp_path / "a.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SteerdError, match=what) as caught:
        open_table(path)
    assert caught.value.code == ExitCode.UNREADABLE
