"""What is kept in a cache is believed only as it was kept, and where nobody else writes."""

import os

import pytest

from steerd.sealed_file import CacheRefused, make_own_folder, read_sealed, seal


@pytest.fixture
def kept(tmp_path):
    folder = tmp_path / "cache" / "codes"
    make_own_folder(folder)
    path = folder / "a.so"
    path.write_bytes(seal(path.name, b"code"))
    path.chmod(0o644)
    return path


def test_what_was_kept_comes_back_and_another_files_content_is_refused(kept):
    assert read_sealed(kept) == b"code"
    assert read_sealed(kept.with_name("none")) is None
    other = kept.with_name("b.so")
    other.write_bytes(kept.read_bytes())
    with pytest.warns(CacheRefused, match="b.so is damaged or was changed"):
        assert read_sealed(other) is None


@pytest.mark.parametrize("mode", [0o664, 0o646])
def test_a_file_that_others_may_write_is_refused(kept, mode):
    kept.chmod(mode)
    with pytest.warns(CacheRefused, match="a.so may be written by others; it is made anew"):
        assert read_sealed(kept) is None


def test_a_folder_that_others_may_write_is_refused_and_closed(kept):
    kept.parent.chmod(0o775)
    with pytest.warns(CacheRefused, match="may be written by others"):
        assert read_sealed(kept) is None
    make_own_folder(kept.parent)
    assert read_sealed(kept) == b"code"


@pytest.mark.parametrize("which", ["file", "folder"])
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_a_foreign_file_is_refused(kept, which):
    os.chown(kept if which == "file" else kept.parent, 12345, -1)
    with pytest.warns(CacheRefused, match="belongs to another user"):
        assert read_sealed(kept) is None


def test_a_link_or_a_pipe_is_no_file_of_the_cache(kept):
    link = kept.with_name("link")
    link.symlink_to(kept)
    os.mkfifo(kept.with_name("pipe"), 0o600)
    assert read_sealed(link) is None
    with pytest.warns(CacheRefused, match="is damaged"):
        assert read_sealed(kept.with_name("pipe")) is None


def test_new_folders_are_the_users_own_whatever_the_mask(tmp_path):
    old = os.umask(0)
    try:
        make_own_folder(tmp_path / "a" / "b")
    finally:
        os.umask(old)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in ("a", "a/b")] == [0o700, 0o700]
