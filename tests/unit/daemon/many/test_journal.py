"""The journal of finished units: what an interrupted command left is found again, whole."""

import json

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.journal import going_on, journal_path, open_journal

ROWS = {"a": {"x": 0.1 + 0.2, "y": None}, "b": {"x": 1e-300, "y": "wörds"}}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.parquet.journal"


def write(path, rows, purpose="p"):
    with open_journal(path, purpose) as journal:
        for unit, row in rows.items():
            journal.add(unit, row)


def read(path, purpose="p"):
    with open_journal(path, purpose) as journal:
        return journal.rows


def test_rows_come_back_digit_by_digit(path):
    write(path, ROWS)
    assert read(path) == ROWS
    write(path, {"c": {"x": float("inf")}})
    assert read(path) == {**ROWS, "c": {"x": float("inf")}}


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_a_torn_line_is_cut_off_and_its_unit_done_again(path, cut):
    write(path, ROWS)
    path.write_bytes(path.read_bytes()[:-cut])
    assert read(path) == {"a": ROWS["a"]}
    write(path, {"b": ROWS["b"]})
    assert read(path) == ROWS


def test_a_journal_that_never_got_its_first_line_is_begun_anew(path):
    path.write_bytes(b'{"schema": "steerd.jou')
    write(path, ROWS)
    assert read(path) == ROWS


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (json.dumps({"schema": "steerd.journal/1", "of": "other"}) + "\n", "another command"),
        ("a note of mine\n", "no journal of steerd"),
        ("[]\n", "no journal of steerd"),
        (json.dumps({"schema": "x", "of": "p"}) + "\n", "no journal of steerd"),
    ],
)
def test_another_ones_file_is_refused_and_stays(path, text, said):
    path.write_text(text)
    with pytest.raises(SteerdError, match=said) as caught:
        read(path)
    assert caught.value.code is ExitCode.USAGE
    assert path.read_text() == text


def test_two_commands_do_not_write_one_journal(path):
    with (
        open_journal(path, "p"),
        pytest.raises(SteerdError, match="another command is writing"),
        open_journal(path, "p"),
    ):
        pass


def test_without_a_file_rows_stay_in_memory(tmp_path):
    with open_journal(None, "p") as journal:
        journal.add("a", {"x": 1})
        assert journal.rows == {"a": {"x": 1}}
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SteerdError, match="No such file"):
        read(tmp_path / "none" / "x.journal")


def test_ctrl_c_says_that_the_command_goes_on(tmp_path, capsys):
    output = tmp_path / "out.parquet"
    with pytest.raises(KeyboardInterrupt), going_on(output):
        raise KeyboardInterrupt
    assert str(journal_path(output)) in capsys.readouterr().err
    with pytest.raises(KeyboardInterrupt), going_on(None):
        raise KeyboardInterrupt
    assert capsys.readouterr().err == ""
