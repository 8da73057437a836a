import math

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.rollout import simulate as simulate_car
from steerd.car_model.rollout import start
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import NO_HISTORY, History, add_command, command_at, drop_older
from steerd.estimator.reference import Reference

MS = 1_000_000
CAR = DEFAULT_CAR._replace(steer_delay=0.012, drive_delay=0.004)
drive = Reference(CAR, SINGLE_TRACK, FilterConfig(), {}).drive


def random_history(
    seed: int, count: int = 40, scale: float = 1.0
) -> tuple[History, list[Command[float]]]:
    """Commands every 5 ms about straight on at 1.5 m/s; at full scale they reach every limit."""
    rng = np.random.default_rng(seed)
    draws = scale * rng.uniform(-1.0, 1.0, (count, 2))
    commands = [Command(0.4 * float(a), 1.5 + 1.5 * float(v)) for a, v in draws]
    return History(tuple(range(0, count * 5 * MS, 5 * MS)), tuple(commands)), commands


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("scale", "tolerance"), [(0.1, 1e-12), (1.0, 0.02)])
def test_actuators_follow_the_car_model_under_delayed_commands(seed, scale, tolerance):
    """To the last digit within the slew limits; a limit left midway is only met to a step."""
    history, commands = random_history(seed, scale=scale)
    grid = [command for command in commands for _ in range(5)]
    first = ORIGIN._replace(speed=1.5, steer=0.02)
    run = simulate_car(FLOAT, Model(CAR), start(Model(CAR), first, 0.0), grid, 0.001)
    begin, end = 30, 190
    now = run[begin].state
    out = drive(history, now.steer, now.speed, begin * MS, end * MS)
    span = (end - begin) * 1e-3
    assert out.steer == pytest.approx(run[end].state.steer, abs=tolerance)
    assert now.speed + span * out.accel == pytest.approx(run[end].state.speed, abs=tolerance)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("span_ms", [2, 5, 17])
def test_derivatives_are_exact(seed, span_ms):
    history, _ = random_history(seed)
    rng = np.random.default_rng(seed)
    steer, speed = float(rng.uniform(-0.2, 0.2)), float(rng.uniform(1.0, 2.0))
    begin = 61 * MS
    end = begin + span_ms * MS
    out = drive(history, steer, speed, begin, end)
    eps = 1e-7
    right = drive(history, steer + eps, speed + eps, begin, end)
    assert (right.steer - out.steer) / eps == pytest.approx(out.steer_by_steer, abs=1e-6)
    assert (right.wheel - out.wheel) / eps == pytest.approx(out.wheel_by_steer, abs=1e-6)
    assert (right.accel - out.accel) / eps == pytest.approx(out.accel_by_speed, abs=1e-6)


def test_without_a_command_steering_holds_and_the_car_rolls():
    out = drive(NO_HISTORY, 0.2, 1.0, 0, 10 * MS)
    assert (out.steer, out.wheel, out.accel) == (0.2, 0.2, 0.0)
    released = add_command(add_command(NO_HISTORY, 0, Command(0.3, 3.0)), 5 * MS, None)
    out = drive(released, 0.2, 1.0, 30 * MS, 40 * MS)
    assert (out.steer, out.accel, out.steered) == (0.2, 0.0, False)


def test_history_keeps_order_and_the_command_in_force():
    history = NO_HISTORY
    for t in (20, 0, 10):
        history = add_command(history, t, Command(float(t), 0.0))
    assert history.times == (0, 10, 20)
    assert command_at(history, -1) is None
    assert command_at(history, 15) == Command(10.0, 0.0)
    assert add_command(history, 10, None).commands[1] is None
    assert drop_older(history, 15).times == (10, 20)
    assert drop_older(history, -5).times == history.times


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_not_finite_is_an_error(bad):
    with pytest.raises(ValueError, match="not finite"):
        add_command(NO_HISTORY, 0, Command(0.0, bad))
