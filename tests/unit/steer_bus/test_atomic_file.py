"""A file is replaced whole or not at all."""

import stat

import pytest

from steerd.steer_bus import atomic_file
from steerd.steer_bus.atomic_file import write_atomically


def test_a_file_is_made_and_replaced(tmp_path):
    path = tmp_path / "car.toml"
    write_atomically(path, "mass = 3.5 # kg, ±0.1\n")
    assert path.read_text(encoding="utf-8") == "mass = 3.5 # kg, ±0.1\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    write_atomically(path, b"\x00\xff", mode=0o600)
    assert path.read_bytes() == b"\x00\xff"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_keeps_the_old_file_and_leaves_nothing(tmp_path, monkeypatch):
    path = tmp_path / "car.toml"
    path.write_text("old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic_file.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_missing_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "no" / "car.toml", "x")
