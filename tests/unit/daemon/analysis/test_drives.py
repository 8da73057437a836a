"""One drive under two names: recognised by its content, for a copy is no second drive."""

import pytest

from steerd.daemon.analysis.drives import is_same, refuse_copies, without_reserved
from steerd.daemon.common.errors import SteerdError


@pytest.fixture
def drives(tmp_path):
    """Two drives of one length, a copy, a link and a name without a file."""
    (tmp_path / "a.mcap").write_bytes(b"first")
    (tmp_path / "b.mcap").write_bytes(b"other")
    (tmp_path / "copy.mcap").write_bytes(b"first")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "a.mcap")
    return {name: tmp_path / f"{name}.mcap" for name in ("a", "b", "copy", "link", "none")}


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("a", "a", True),
        ("a", "copy", True),
        ("a", "link", True),
        ("link", "copy", True),
        ("a", "b", False),
        ("a", "none", False),
        ("none", "none", True),
    ],
)
def test_what_is_the_same_drive(one, other, same, drives):
    assert is_same(drives[one], drives[other]) is same


def test_a_drive_counts_once(drives):
    refuse_copies([drives["a"], drives["b"], drives["none"]])
    with pytest.raises(SteerdError, match="named twice"):
        refuse_copies([drives["a"], drives["b"], drives["a"]])
    with pytest.raises(SteerdError, match=r"copy\.mcap is a copy of .*a\.mcap"):
        refuse_copies([drives["a"], drives["b"], drives["copy"]])


def test_what_is_held_out_is_not_among_the_others(drives):
    given = [drives["a"], drives["b"]]
    assert without_reserved(given, [drives["copy"]], "fit") == (drives["b"],)
    with pytest.raises(SteerdError, match="nothing is left to fit"):
        without_reserved([drives["a"]], [drives["copy"]], "fit")
