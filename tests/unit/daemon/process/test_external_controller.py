"""A controller of one's own: in virtual time, within the limits, to a stop."""

import math
import warnings

import numpy as np
import pytest

import steerd
from steerd.car_model.state import State
from steerd.daemon.process.external_controller import Lane

CIRCLE = {"path": "circle:radius=2", "speed": 1.5, "duration": 6.0, "seed": 3}


def follow(t: float, state: State[float], lane: Lane) -> tuple[float, float]:
    """Steers by lane errors alone, and never stops by itself."""
    return math.atan(0.33 * lane.curvature) - 0.8 * lane.e1 - lane.e2, 1.5


def test_a_function_drives_to_a_stop_and_the_drive_replays(tmp_path, cli):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no watchdog ended the drive
        drive = steerd.simulate(**CIRCLE, controller=follow, record=tmp_path / "own.mcap")
        again = steerd.simulate(**CIRCLE, controller=follow)
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
