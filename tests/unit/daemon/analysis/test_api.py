"""Python's own steerd: drives and tables, a controller of one's own, identify, diagnose, steps."""

import html
import json
import math
import sys
import warnings

import numpy as np
import pytest
from IPython.lib import pretty

import steerd
from steerd.car_model.car_file import load_car
from steerd.car_model.state import State
from steerd.daemon.analysis.environment import OBSERVED
from steerd.daemon.process.external_controller import Lane
from steerd.steer_bus.messages import MocapPose
from steerd.steer_bus.session_read import open_session

pytestmark = pytest.mark.slow

FREE, ONLY = ["steer_delay", "speed_lag"], ["steer_delay", "steer_backlash", "speed_delay"]
DELAY, ROUND = 0.05, "circle:radius=2"
DIAGNOSED = {"only": ONLY, "pairs": False, "closed_loop": False}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return steerd.simulate(
        path="figure8", speed=1.8, duration=25.0, seed=1, effects={"steer_delay": DELAY},
        record=tmp_path_factory.mktemp("drive") / "late.mcap",
    )  # fmt: skip


fit = pytest.fixture(lambda drive: steerd.identify(drive, free=FREE, held_out=3), scope="module")
gap = pytest.fixture(lambda drive: steerd.diagnose(drive, **DIAGNOSED), scope="module")


def test_the_command_line_gives_the_same_numbers(drive, fit, cli):
    words = ["identify", str(drive.path), "--free", ",".join(FREE), "--held-out", "3"]
    assert json.loads(cli(*words, "--json", "-").out) == json.loads(json.dumps(fit.to_json()))


def test_parameters_have_values_errors_and_units(fit):
    assert set(fit.parameters) == set(FREE)
    delay = fit.parameters["steer_delay"]
    assert delay.value == pytest.approx(delay.start + DELAY, abs=0.01)
    assert 0.0 < delay.sd < 0.02
    assert delay.unit == "s"
    assert fit.improved
    assert "steer_delay" in str(fit)


@pytest.mark.parametrize("name", ["drive", "fit", "gap"])
def test_no_value_fills_more_than_a_screen_of_a_cell(name, request):
    """As IPython shows it, at 100 columns; what a value holds is looked at one by one."""
    value = request.getfixturevalue(name)
    public = [each for each in dir(value) if not each.startswith("_")]
    held = [(each, getattr(value, each)) for each in public]
    for each, one in [(name, value), *((each, one) for each, one in held if not callable(one))]:
        text = pretty.pretty(one)
        lines = sum(1 + len(line) // 100 for line in text.splitlines())
        assert lines <= 60, f"{each}: {lines} lines, more than a screen nobody reads"
    page = value._repr_html_()
    assert all(html.escape(card.figure) in page for card in value.cards)
    assert len(value.cards) >= 3
    assert page.index("<details>") < page.index("<pre>")


def test_the_identified_car_is_simulated_saved_and_read_again(fit, tmp_path):
    path = fit.save_car(tmp_path / "car.toml")
    assert load_car(path).car == fit.car.car
    assert "noise" in load_car(path).sections
    delay = fit.parameters["steer_delay"]  # the file has the digits that the error leaves
    assert fit.car.car.steer_delay == pytest.approx(delay.value, abs=0.1 * delay.sd)
    session = steerd.simulate(fit, ROUND, duration=1.0)
    assert session.metadata["steerd.vehicle"]["steer_delay"] == repr(fit.car.car.steer_delay)


def test_a_cause_is_named_and_goes_into_the_car(gap):
    (cause,) = gap.causes
    value, sd, unit = cause.parameters["delay"]
    assert (gap.verdict, cause.effect, unit) == ("explained", "steer_delay", "s")
    assert value == pytest.approx(DELAY, abs=0.01)
    assert math.isfinite(sd)
    assert [effect.name for effect in gap.car.effects] == ["tyre_saturation", "steer_delay"]
    assert gap.car.values[1][0] == pytest.approx(value, abs=0.1 * sd)
    data = gap.to_json()
    assert data["schema"] == "steerd.gap/1"
    assert data["residual"]["sessions"] == ["late.mcap"]


# The stepping environment: the same episode again, its ends, its errors.
def follow(observation):
    """A lane keeper of one line."""
    e1, e2, curvature, *_ = observation
    return 0.33 * curvature - 0.8 * e1 - e2, 1.0


def episode(env, seed, policy=follow):
    observation, _ = env.reset(seed=seed)
    rows = []
    while True:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        rows.append([*observation, reward])
        if terminated or truncated:
            return np.array(rows), terminated, truncated, info


def test_the_same_seed_and_actions_give_the_same_episode():
    env = steerd.Environment(path=ROUND, duration=2.0)
    one, terminated, truncated, info = episode(env, 4)
    assert (terminated, truncated, info["t"]) == (False, True, pytest.approx(2.0))
    assert one.shape == (200, len(OBSERVED) + 1)
    assert np.array_equal(one, episode(env, 4)[0])
    assert not np.array_equal(one, episode(env, 5)[0])
    assert np.abs(one[:, 0]).max() < 0.1
    with pytest.raises(steerd.SteerdError, match="episode is over"):
        env.step((0.0, 0.0))


def test_leaving_the_lane_terminates_the_episode():
    env = steerd.Environment(path=ROUND, duration=8.0)
    _, terminated, truncated, info = episode(env, 4, lambda _: (-0.26, 1.0))
    assert (terminated, truncated) == (True, False)
    assert 0.5 < -info["state"].e1 < 0.55
    assert 0.0 < info["t"] < 8.0


# `steerd.load` and `steerd.simulate`: tables with the drive's own numbers, and clear refusals.
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


def test_a_recorded_simulation_is_loaded_again_and_is_the_same_for_the_same_seed(tmp_path):
    out, short = tmp_path / "drive.mcap", {"path": ROUND, "duration": 1.0}
    assert steerd.simulate(**short, seed=3, record=out).path == out
    recorded = steerd.load(out).table("mocap")["x"]
    same, other = (steerd.simulate(**short, seed=n).table("mocap")["x"] for n in (3, 4))
    assert np.array_equal(recorded, same)
    assert not np.array_equal(recorded, other)


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
            path=ROUND, speed=2.0, duration=20.0, effects={"steer_delay": 0.3}
        )
    assert session.duration < 10.0


# A controller of one's own: in virtual time, within the limits, to a stop.
CIRCLE = {"path": ROUND, "speed": 1.5, "duration": 6.0, "seed": 3}


def steer(t: float, state: State[float], lane: Lane) -> tuple[float, float]:
    """Steers by lane errors alone, and never stops by itself."""
    return math.atan(0.33 * lane.curvature) - 0.8 * lane.e1 - lane.e2, 1.5


def test_a_function_drives_to_a_stop_and_the_drive_replays(tmp_path, cli):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no watchdog ended the drive
        drive = steerd.simulate(**CIRCLE, controller=steer, record=tmp_path / "own.mcap")
        again = steerd.simulate(**CIRCLE, controller=steer)
    state = drive.table("state")
    moving = state[state["speed"] > 1.4]
    assert len(moving) > 300
    assert np.abs(moving["e1"][100:]).max() < 0.15
    assert drive.path.read_bytes() == again.path.read_bytes()
    assert "all equal the recorded ones" in cli("replay", drive.path).out


def test_the_cars_limits_hold_for_a_function(tmp_path):
    drive = steerd.simulate(**CIRCLE, controller=lambda t, state, lane: (0.2, 50.0))
    state = drive.table("state")
    assert np.nanmax(np.abs(state["speed"] * state["yaw_rate"])) < 12.0
    assert np.nanmax(state["speed"]) < 6.0


@pytest.mark.parametrize("command", [None, 3.0, (0.1,), ("left", 1.0), (math.nan, 1.0)])
def test_what_is_no_command_is_refused_in_one_line(command):
    with pytest.raises(steerd.SteerdError, match="not two finite numbers"):
        steerd.simulate(**CIRCLE, controller=lambda t, state, lane: command)


def test_an_error_of_the_function_is_the_users_to_see():
    with pytest.raises(ZeroDivisionError):
        steerd.simulate(**CIRCLE, controller=lambda t, state, lane: 1 / 0)
