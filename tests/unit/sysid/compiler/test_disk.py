"""Compiled code that cannot be kept costs time and a line, never the command."""

import errno
import os
import sys
from pathlib import Path

import pytest

from steerd.car_model.machine_code import CodeNotKept
from steerd.sealed_file import CacheRefused
from steerd.sysid.compiler import disk, modules

SOURCE = """
from steerd.sysid.compiler.compile import entry_point

@entry_point
def double(x):
    return 2.0 * x
"""
FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache folder for a model of one line, and a place for temporary ones beside it."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(modules, "module_source", lambda *_: SOURCE)
    monkeypatch.setenv(disk.CACHE_VARIABLE, str(tmp_path / "cache"))
    yield tmp_path / "cache"
    for name in [name for name in sys.modules if name.startswith("steerd_model_")]:
        if str(sys.modules[name].__file__).startswith(str(tmp_path)):
            del sys.modules[name]


def load():
    return modules.load_module.__wrapped__()


def refuse(*_, **__):
    raise FULL


def test_where_the_folder_cannot_be_made_a_temporary_one_serves(folder):
    folder.write_text("a file, not a folder")
    with pytest.warns(CodeNotKept, match=r"cache: Not a directory; compiled code is not kept"):
        module = load()
    assert module.double(4.0) == 8.0
    used = disk.cache_folder()
    assert used.parent == folder.parent / "temporary"
    assert Path(module.__file__).is_relative_to(used)
    assert load().double(1.5) == 3.0, "later models go there without another word"


def test_a_folder_in_which_numba_finds_no_place_is_replaced(folder, monkeypatch):
    (folder / "kernels").mkdir(parents=True)
    (folder / "kernels/__pycache__").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "kernels/__pycache__"))
    with pytest.warns(CodeNotKept, match="cannot cache function"):
        assert load().double(4.0) == 8.0


def test_without_any_place_the_error_names_the_folder(folder, monkeypatch):
    monkeypatch.setattr(modules, "write_atomically", refuse)
    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(OSError, match="No space left") as caught:
        load()
    assert caught.value.errno == errno.ENOSPC
    assert caught.value.filename == str(folder)


def test_a_disk_that_fills_while_code_is_kept_stops_nothing(folder, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(disk, "write_atomically", refuse)
        module = load()
        with pytest.warns(CodeNotKept, match="__pycache__: No space left on device"):
            assert module.double(4.0) == 8.0
    again = load()
    assert again.double(4.0) == 8.0
    assert not again.double.stats.cache_hits
    assert load().double.stats.cache_path == str(folder / "kernels/__pycache__")


@pytest.mark.parametrize("content", [b"", b"cut", None], ids=["empty", "cut", "a bit"])
def test_code_that_a_power_cut_damaged_is_compiled_again(folder, content):
    load().double(4.0)
    (kept,) = (folder / "kernels").rglob("*.nbc")
    whole = kept.read_bytes()
    kept.write_bytes(
        whole[:99] + bytes([whole[99] ^ 4]) + whole[100:] if content is None else content
    )
    damaged = load()
    with pytest.warns(CacheRefused, match="is damaged or was changed; it is made anew"):
        assert damaged.double(4.0) == 8.0
    assert not damaged.double.stats.cache_hits
    again = load()
    assert again.double(4.0) == 8.0
    assert sum(again.double.stats.cache_hits.values()) == 1


def test_the_printed_module_is_never_read_back(folder):
    path = Path(load().__file__)
    path.write_text("raise SystemExit('what lies in a cache was run')")
    assert load().double(4.0) == 8.0


def test_a_temporary_folder_goes_with_the_process_that_made_it(tmp_path):
    (tmp_path / "kernels").mkdir()
    disk._remove(str(tmp_path), os.getpid() + 1)
    assert tmp_path.exists()
    disk._remove(str(tmp_path), os.getpid())
    assert not tmp_path.exists()
