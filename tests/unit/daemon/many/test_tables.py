"""Parquet files: values and units come back, the same rows are the same bytes."""

import math

import polars

from steerd.daemon.many.tables import Column, encode_table

COLUMNS = (
    Column("speed", "number", "m/s", "how fast"),
    Column("count", "count", "", "how often"),
    Column("name", "text", "", "which"),
    Column("good", "truth", "", "whether"),
)
ROWS = (
    {"speed": 0.1 + 0.2, "count": 3, "name": "a", "good": True},
    {"speed": math.nan, "name": None},
    {"speed": -math.inf, "count": 2**60, "name": "ü", "good": False, "other": 1},
)


def test_values_come_back_and_what_is_missing_is_missing(tmp_path):
    path = tmp_path / "t.parquet"
    path.write_bytes(encode_table(COLUMNS, ROWS, {"made": "here"}))
    first, second, third = polars.read_parquet(path).to_dicts()
    assert first == ROWS[0]
    assert second == {"speed": None, "count": None, "name": None, "good": None}
    assert third["speed"] == -math.inf
    assert third["count"] == 2**60


def test_another_reader_takes_them_too(tmp_path):
    path = tmp_path / "t.parquet"
    path.write_bytes(encode_table(COLUMNS, ROWS, {}))
    frame = polars.read_parquet(path)
    assert frame.columns == [column.name for column in COLUMNS]
    assert frame["name"].to_list() == ["a", None, "ü"]


def test_the_same_rows_are_the_same_bytes():
    assert encode_table(COLUMNS, ROWS, {"a": "1"}) == encode_table(COLUMNS, ROWS, {"a": "1"})
    assert encode_table(COLUMNS, ROWS, {}) != encode_table(COLUMNS, ROWS[:2], {})


def test_an_empty_table_has_its_columns(tmp_path):
    path = tmp_path / "t.parquet"
    path.write_bytes(encode_table(COLUMNS, (), {}))
    assert polars.read_parquet(path).columns == [column.name for column in COLUMNS]
