"""One drive under two names: recognised by its content, for a copy is no second drive."""

from pathlib import Path

import numpy as np
import pytest

from steerd.daemon.analysis import drives as module
from steerd.daemon.analysis.drives import is_same, load_drives, split_drives
from steerd.daemon.analysis.options import HeldOut, Watch, read_car
from steerd.sim_gap.diagnosis import Case
from steerd.sysid.data.dataset import Signal, make_run


@pytest.fixture
def drives(tmp_path):
    """Two drives of one length, a copy, a link and a name without a file."""
    (tmp_path / "a.mcap").write_bytes(b"first")
    (tmp_path / "b.mcap").write_bytes(b"other")
    (tmp_path / "copy.mcap").write_bytes(b"first")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "a.mcap")
    return {name: tmp_path / f"{name}.mcap" for name in ("a", "b", "copy", "link", "none")}


@pytest.mark.parametrize(("one", "other", "same"), [
    ("a", "a", True), ("a", "copy", True), ("a", "link", True), ("link", "copy", True),
    ("a", "b", False), ("a", "none", False), ("none", "none", True),
])  # fmt: skip
def test_what_is_the_same_drive(one, other, same, drives):
    assert is_same(drives[one], drives[other]) is same


@pytest.fixture
def minutes(monkeypatch):
    """Sessions that are as many minutes long as their names say."""

    def load(path, speed, watch):
        t = np.arange(0.0, 60.0 * float(path.stem), 0.02)
        turned = t / 5.0
        pose = np.column_stack([5.0 * np.sin(turned), -5.0 * np.cos(turned), turned])
        steer, speed = Signal(t, 0.1 * np.sin(t)), Signal(t, np.ones_like(t))
        return None, make_run(path.name, steer, speed, Signal(t, pose))

    monkeypatch.setattr(module, "load_drive", load)

    def opened(*names):
        said, read = [], []
        paths = [Path(f"{name}.mcap") for name in names]
        found = load_drives(paths, "command", Watch(said.extend), read.append)
        assert read == [(n + 1) / len(paths) for n in range(len(paths))]
        return found.runs, said

    return opened


def test_short_drives_are_taken_whole_and_of_long_ones_pieces_which_is_said(minutes):
    found, said = minutes(2, 3)
    assert [run.driven for run in found] == pytest.approx([120.0, 180.0], abs=0.03)
    assert said == []
    found, said = minutes(90, 1)
    assert sum(run.driven for run in found) == pytest.approx(660.0, rel=0.05)
    assert said == ["of 1.5 h 11 min are used, in pieces of 30 s, evenly from all sessions"]
    assert {run.name for run in found} == {"90.mcap", "1.mcap"}


def test_many_sessions_share_what_is_looked_at(minutes):
    found, said = minutes(*range(2, 82))
    assert sum(run.driven for run in found) == pytest.approx(1200.0, rel=0.03)
    assert sum(run.driven for run in found) <= 1200.0
    numbers = [int(run.name.removesuffix(".mcap")) for run in found]
    assert (numbers[0], numbers[-1], set(np.diff(numbers))) == (2, 81, {2, 3})
    assert said[0].startswith("of 55.")


def test_sessions_are_held_out_whole_though_they_are_in_pieces(minutes):
    found, _ = minutes(20, 21, 22, 23, 24)
    case = split_drives(Case(found, read_car(None)), HeldOut(), "command", Watch())
    assert case.held_out_of == "every 4th session: 23.mcap"
    assert {run.name for run in case.later()} == {"23.mcap"}
    assert {run.name for run in case.runs} == {f"{n}.mcap" for n in (20, 21, 22, 24)}
