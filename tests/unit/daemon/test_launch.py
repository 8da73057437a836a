"""The launch window: a good launch passes, each wiring mistake is found within the first metres."""

from math import cos, pi, sin, tan

import pytest

from daemon.launch import LaunchInput, make_launch_state, step_launch

WHEELBASE = 0.33


def launch(steer=0.0, scale=1.0, flip=0.0, turn=1.0, erpm=1.0, speed=0.5, yaw0=0.3, noise=0.0):
    """Drive a kinematic car; return (what was wrong, distance by the wheels, done)."""
    x = y = travelled = 0.0
    yaw, dt = yaw0, 0.01
    start = LaunchInput(0, x * scale, y * scale, yaw + flip, 0.0, steer)
    state, wrong = make_launch_state(start), ""
    for k in range(1, 400):
        x, y = x + speed * dt * cos(yaw), y + speed * dt * sin(yaw)
        yaw += turn * speed * dt * tan(steer) / WHEELBASE
        wobble = noise if k % 2 else -noise
        i = LaunchInput(k * 10**7, x * scale + wobble, y * scale, yaw + flip, speed * erpm, steer)
        state, wrong = step_launch(state, i, WHEELBASE)
        travelled += abs(speed) * erpm * dt
        if wrong or state.done:
            break
    return wrong, travelled, state.done


@pytest.mark.parametrize("steer", [0.0, 0.34, -0.34, 0.05])
@pytest.mark.parametrize("yaw0", [0.0, 3.0, -3.1])
def test_a_good_launch_ends_after_half_a_metre(steer, yaw0):
    wrong, travelled, done = launch(steer=steer, yaw0=yaw0, noise=0.002)
    assert (wrong, done) == ("", True)
    assert travelled == pytest.approx(0.5, abs=0.006)


@pytest.mark.parametrize("scale", [0.001, 1000.0, 0.0, 0.69, 1.42])
def test_wrong_unit_or_gear_is_found(scale):
    wrong, travelled, done = launch(scale=scale)
    assert "units" in wrong
    assert travelled <= 0.26
    assert not done


@pytest.mark.parametrize("scale", [0.71, 1.39])
def test_a_tolerable_gear_ratio_passes(scale):
    assert launch(scale=scale)[0] == ""


def test_wheels_that_do_not_count_are_found_by_mocap():
    assert "units" in launch(erpm=0.0)[0]


@pytest.mark.parametrize(("flip", "found"), [
    (pi, True), (pi / 2, True), (-0.55, True), (0.55, True), (0.5, False), (-0.5, False),
])  # fmt: skip
def test_body_turned_round_is_found(flip, found):
    assert ("body forward axis" in launch(flip=flip)[0]) is found


@pytest.mark.parametrize("steer", [0.2, -0.2])
def test_inverted_steering_is_found(steer):
    wrong, _, done = launch(steer=steer, turn=-1.0)
    assert "against its steering" in wrong
    assert not done


def test_hardly_steered_launches_say_nothing_about_the_sign():
    assert launch(steer=0.05, turn=-1.0)[0] == ""  # expected turn below 0.1 rad
    assert launch(steer=0.2, turn=-0.05)[0] == ""  # measured turn below 0.03 rad


def test_a_reversing_car_is_judged_in_its_own_direction():
    assert launch(speed=-0.5)[0] == ""
    assert "body forward axis" in launch(speed=-0.5, flip=pi)[0]


def test_done_stays_done_and_time_does_not_run_backwards():
    start = LaunchInput(0, 0.0, 0.0, 0.0, 0.5, 0.0)
    state = make_launch_state(start)
    back, wrong = step_launch(state, start._replace(t_ns=-(10**9)), WHEELBASE)
    assert (back.travelled, wrong) == (0.0, "")
    done = state._replace(done=True)
    assert step_launch(done, start._replace(x=99.0), WHEELBASE) == (done, "")


def shown(mocap, wheels, turned=0.0, expected=0.0, sideways=0.0):
    """What one more, motionless tick says to a launch that has shown this, far from the origin."""
    here = LaunchInput(0, 5.0 + mocap, -3.0, 0.0, 0.0, 0.0)
    state = make_launch_state(here)._replace(
        x0=5.0, travelled=wheels, turned=turned, expected_turn=expected, forward=mocap
    )
    return step_launch(state._replace(sideways=sideways), here, WHEELBASE)


def test_every_bound_of_the_launch_exactly():
    assert shown(0.0, 0.2499)[1] == ""
    assert "units" in shown(0.0, 0.25)[1]
    assert "units" in shown(0.25, 0.0)[1]
    assert shown(0.5, 0.5) == (shown(0.5, 0.5)[0]._replace(done=True), "")
    assert not shown(0.5, 0.4999)[0].done
    assert "against" in shown(0.5, 0.5, turned=-0.03, expected=0.10)[1]
    assert shown(0.5, 0.5, turned=-0.0299, expected=0.10)[1] == ""
    assert shown(0.5, 0.5, turned=-0.03, expected=0.0999)[1] == ""
    assert shown(0.5, 0.5, turned=0.03, expected=0.10)[1] == ""
    assert "heading" in shown(0.5, 0.5, sideways=0.5 * tan(pi / 6) + 1e-9)[1]
    assert shown(0.5, 0.5, sideways=0.5 * tan(pi / 6) - 1e-9)[1] == ""
