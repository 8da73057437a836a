"""`steerd.load` and `steerd.simulate`: tables with the drive's own numbers, and clear refusals."""

import sys

import numpy as np
import pytest

import steerd
from steerd.steer_bus.messages import MocapPose
from steerd.steer_bus.session_read import open_session

SECONDS = 4.0


@pytest.fixture(scope="module")
def drive():
    return steerd.simulate(path="circle:radius=2", speed=1.0, duration=SECONDS, seed=3)


def test_a_table_has_the_messages_of_the_topic_and_their_time(drive):
    table = drive.table("mocap")
    columns = open_session(drive.path).columns(MocapPose)
    assert table.shape == columns["x"].shape
    assert np.array_equal(table["x"], columns["x"])
    assert table.dtype.names[0] == "t"
    steps = np.diff(table["t"])
    assert np.median(steps) == pytest.approx(0.01, abs=1e-4)
    assert 0.0 <= table["t"][0] < 0.1
    assert table["t"][-1] <= drive.duration


def test_topics_go_by_short_and_by_whole_names(drive):
    assert {"state", "mocap", "actuation", "tick"} <= set(drive.topics)
    whole = drive.table("/steerd/car1/state")
    assert np.array_equal(whole["t"], drive.table("state")["t"])
    assert set(drive.tables()) == set(drive.topics)


def test_frames_hold_the_same_and_arrays_are_columns_of_their_own(drive):
    table, frame = drive.table("odom"), drive.to_pandas("odom")
    name = "pose.covariance"
    assert table[name].shape == (len(table), 36)
    np.testing.assert_array_equal(frame[f"{name}.35"], table[name][:, 35])
    assert name not in frame
    units = drive["state"].attrs["units"]
    assert (units["t"], units["e1"], units["yaw_rate"]) == ("s", "m", "rad/s")
    assert "mode" not in units
    one, other = drive.to_pandas("mocap"), drive.to_polars("mocap")
    assert list(one.columns) == other.columns
    assert np.array_equal(one["yaw"].to_numpy(), other["yaw"].to_numpy())
    assert one["reject"].tolist() == other["reject"].to_list()


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_a_missing_package_is_named(package, drive, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(steerd.SteerdError, match=f"{package} is not installed") as refused:
        getattr(drive, f"to_{package}")("state")
    assert refused.value.hint == f"pip install {package}"


def test_an_unknown_topic_says_which_there_are_and_no_file_is_refused(drive, tmp_path):
    with pytest.raises(steerd.SteerdError, match="no table 'lidar'") as refused:
        drive.table("lidar")
    assert "mocap" in refused.value.hint
    with pytest.raises(steerd.SteerdError, match="does not exist"):
        steerd.load(tmp_path / "none.mcap")


def test_a_recorded_simulation_is_loaded_again_and_is_the_same_for_the_same_seed(drive, tmp_path):
    out = tmp_path / "drive.mcap"
    again = steerd.simulate(path="circle:radius=2", speed=1.0, duration=SECONDS, seed=3, record=out)
    assert again.path == out
    x = steerd.load(out).table("mocap")["x"]
    assert np.array_equal(x, drive.table("mocap")["x"])
    other = steerd.simulate(path="circle:radius=2", speed=1.0, duration=SECONDS, seed=4)
    assert not np.array_equal(x, other.table("mocap")["x"])


def test_a_temporary_drive_goes_with_its_value():
    session = steerd.simulate(duration=1.0)
    path = session.path
    assert isinstance(session, steerd.Session)
    assert path.is_file()
    del session
    assert not path.exists()


@pytest.mark.parametrize(
    "value", [0.05, (0.05,), {"delay": 0.05}, np.float64(0.05), np.array([0.05])]
)
def test_effects_are_those_of_the_command_line(value):
    session = steerd.simulate(duration=1.0, effects={"steer_delay": value})
    assert '"effects":["steer_delay' in session.metadata["steerd.session"]["options"]
    assert "0.05" in session.metadata["steerd.session"]["options"]


@pytest.mark.parametrize(("arguments", "what"), [
    ({"duration": 0.0}, "duration 0"), ({"effects": {"wings": 1.0}}, "wings"),
])  # fmt: skip
def test_arguments_that_make_no_sense(arguments, what):
    with pytest.raises(steerd.SteerdError, match=what):
        steerd.simulate(**arguments)


def test_a_drive_that_a_watchdog_ends_says_so():
    with pytest.warns(UserWarning, match="the drive was stopped"):
        session = steerd.simulate(
            path="circle:radius=2", speed=2.0, duration=20.0, effects={"steer_delay": 0.3}
        )
    assert session.duration < 10.0
