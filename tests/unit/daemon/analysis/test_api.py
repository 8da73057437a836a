"""`steerd.identify`, `steerd.diagnose`: the numbers of the command line; `steerd.Environment`."""

import html
import json
import math

import numpy as np
import pytest
from IPython.lib import pretty

import steerd
from steerd.car_model.car_file import load_car
from steerd.daemon.analysis.environment import OBSERVED

pytestmark = pytest.mark.slow

FREE, ONLY = ["steer_delay", "speed_lag"], ["steer_delay", "steer_backlash", "speed_delay"]
DELAY = 0.05


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return steerd.simulate(
        path="figure8", speed=1.8, duration=25.0, seed=1, effects={"steer_delay": DELAY},
        record=tmp_path_factory.mktemp("drive") / "late.mcap",
    )  # fmt: skip


fit = pytest.fixture(lambda drive: steerd.identify(drive, free=FREE, held_out=3), scope="module")


@pytest.fixture(scope="module")
def gap(drive):
    return steerd.diagnose(drive, only=ONLY, pairs=False, closed_loop=False)


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
    session = steerd.simulate(fit, "circle:radius=2", duration=1.0)
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


@pytest.fixture(scope="module")
def env():
    return steerd.Environment(path="circle:radius=2", duration=2.0)


def test_the_same_seed_and_actions_give_the_same_episode(env):
    one, terminated, truncated, info = episode(env, 4)
    assert (terminated, truncated, info["t"]) == (False, True, pytest.approx(2.0))
    assert one.shape == (200, len(OBSERVED) + 1)
    assert np.array_equal(one, episode(env, 4)[0])
    assert not np.array_equal(one, episode(env, 5)[0])
    assert np.abs(one[:, 0]).max() < 0.1
    with pytest.raises(steerd.SteerdError, match="episode is over"):
        env.step((0.0, 0.0))


def test_leaving_the_lane_terminates_the_episode():
    env = steerd.Environment(path="circle:radius=2", duration=8.0)
    _, terminated, truncated, info = episode(env, 4, lambda _: (-0.26, 1.0))
    assert (terminated, truncated) == (True, False)
    assert 0.5 < -info["state"].e1 < 0.55
    assert 0.0 < info["t"] < 8.0
