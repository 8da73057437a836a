"""What a person reads when a file cannot be written."""

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.written import write_whole


def test_text_is_written_whole(tmp_path):
    path = tmp_path / "page.html"
    write_whole(path, "first")
    write_whole(path, "second °")
    assert path.read_text(encoding="utf-8") == "second °"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("place", ["no/page.html", "folder"])
def test_what_cannot_be_written_is_an_error_with_its_path(tmp_path, place):
    (tmp_path / "folder").mkdir()
    path = tmp_path / place
    with pytest.raises(SteerdError) as caught:
        write_whole(path, "x")
    assert caught.value.what.startswith(f"{path}: ")
    assert caught.value.code == ExitCode.UNREADABLE
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]
