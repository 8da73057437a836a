"""The whole controller against the simulated car: how well it keeps the lane, and in how much."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from steerd.car_model.model import Model
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.rollout import start, step
from steerd.car_model.state import ORIGIN, Command, State
from steerd.controller.build import make_controller
from steerd.controller.config import ControllerConfig
from steerd.controller.lane_controller import (
    ControllerState,
    ControlReport,
    LaneController,
    control,
    start_controller,
    to_command,
)

pytestmark = pytest.mark.slow

RATE_HZ = 100.0
SUBSTEPS = 4
SLOW_SERVO = DEFAULT_CAR._replace(steer_lag=0.08, steer_delay=DEFAULT_CAR.steer_delay + 0.03)
"""30 ms more dead time and 80 ms servo lag."""


class Drive(NamedTuple):
    """A simulated drive, a tick each."""

    t: np.ndarray
    e1: np.ndarray
    state: list[State[float]]
    report: list[ControlReport]

    def rms(self, after: float) -> float:
        return float(np.sqrt(np.mean(self.e1[self.t >= after] ** 2)))

    def worst(self, after: float) -> float:
        return float(np.abs(self.e1[self.t >= after]).max())


def drive(
    controller: LaneController,
    plant: Car[float],
    seconds: float,
    first: State[float] = ORIGIN,
    stop_at: float = math.inf,
) -> Drive:
    """Perfect state feedback at 100 Hz on the exact model, its dead time in 2.5 ms steps."""
    h = 1.0 / (RATE_HZ * SUBSTEPS)
    model = Model(plant)
    moment, state = start(model, first, 0.0), start_controller(controller, first, 0)
    late = round(plant.steer_delay / h)
    steer = [0.0] * (late + 1)
    times, states, reports = [], [], []
    for k in range(round(seconds * RATE_HZ)):
        t = k / RATE_HZ
        now = moment.state
        command, report, state = control(controller, state, now, round(t * 1e9), stop=t >= stop_at)
        times.append(t)
        states.append(now)
        reports.append(report)
        for j in range(SUBSTEPS):
            steer.append(command.steer)
            due = Command(steer[-1 - late], command.speed)
            moment = step(FLOAT, model, moment, due, t + j * h, h)
    return Drive(np.array(times), np.array([r.e1 for r in reports]), states, reports)


def made(
    spec: str, speed: float, car: Car[float] = DEFAULT_CAR, **config: object
) -> LaneController:
    settings = ControllerConfig(speed=speed, **config)  # type: ignore[arg-type]
    return make_controller(car, parse_path(spec), settings, RATE_HZ)


@pytest.mark.parametrize("identified", [False, True])
@pytest.mark.parametrize(("spec", "speed"), [("circle:radius=2", 1.0), ("figure8", 1.5)])
def test_a_slow_servo_is_tolerated(spec: str, speed: float, identified: bool) -> None:
    controller = made(spec, speed, SLOW_SERVO if identified else DEFAULT_CAR)
    ran = drive(controller, SLOW_SERVO, 12.0)
    assert ran.rms(after=3.0) <= (0.002 if identified else 0.008)
    assert ran.worst(after=8.0) <= 0.01


@pytest.mark.parametrize("offset", [-0.2, 0.2])
def test_an_offset_on_a_line_is_regulated_without_overshoot(offset: float) -> None:
    ran = drive(made("line:length=20", 1.0), DEFAULT_CAR, 6.0, ORIGIN._replace(y=offset, speed=1.0))
    assert ran.worst(after=4.0) <= 0.001
    assert (ran.e1 / offset).min() >= -0.05


def test_an_open_line_is_stopped_at_its_end() -> None:
    ran = drive(made("line:length=4", 1.0), DEFAULT_CAR, 8.0)
    assert ran.state[-1].x == pytest.approx(4.0, abs=0.02)
    assert ran.state[-1].speed == pytest.approx(0.0, abs=1e-3)


def test_a_cars_gain_and_bias_are_undone() -> None:
    crooked = DEFAULT_CAR._replace(steer_gain=0.8, steer_bias=0.05, speed_gain=0.9)
    ran = drive(made("figure8", 1.5, crooked), crooked, 8.0)
    assert ran.rms(after=3.0) <= 0.002
    assert ran.state[-1].speed == pytest.approx(1.5, abs=1e-3)
    assert to_command(crooked, 0.05, 0.9) == pytest.approx((0.0, 1.0))


def first_ticks(controller: LaneController) -> tuple[ControllerState, State[float]]:
    estimate = ORIGIN._replace(y=0.05, speed=1.0)
    return start_controller(controller, estimate, 0), estimate


def test_a_command_that_left_unchanged_changes_nothing() -> None:
    controller = made("figure8", 1.5, SLOW_SERVO)
    state, estimate = first_ticks(controller)
    assert len(state.past) == 4
    command, _, after = control(controller, state, estimate, 10_000_000)
    alone = control(controller, after, estimate, 20_000_000)
    informed = control(controller, after, estimate, 20_000_000, issued=command)
    assert informed[0] == pytest.approx(alone[0])
    assert informed[2].past == pytest.approx(alone[2].past)


def test_a_command_that_was_held_back_is_remembered_as_it_left() -> None:
    controller = made("figure8", 1.5, SLOW_SERVO)
    state, estimate = first_ticks(controller)
    command, _, after = control(controller, state, estimate, 10_000_000)
    held = command._replace(steer=0.5 * command.steer)
    _, _, informed = control(controller, after, estimate, 20_000_000, issued=held)
    assert informed.past[1] == pytest.approx(held.steer - after.feedforward)


def test_no_delay_means_no_past() -> None:
    controller = made("circle", 1.0, DEFAULT_CAR._replace(steer_delay=0.0))
    state, estimate = first_ticks(controller)
    command, _, after = control(controller, state, estimate, 10_000_000)
    assert after.past == ()
    assert control(controller, after, estimate, 20_000_000, issued=command)[2].past == ()


def test_a_clock_that_stands_or_leaps_is_no_leap_in_speed() -> None:
    controller = made("circle", 1.0)
    state, estimate = start_controller(controller, ORIGIN, 0), ORIGIN
    assert control(controller, state, estimate, 0)[2].speed == 0.0
    assert control(controller, state, estimate, -5)[2].speed == 0.0
    assert control(controller, state, estimate, 10**12)[2].speed == pytest.approx(0.15)


@pytest.mark.parametrize("field", State._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_is_refused(field: str, value: float) -> None:
    controller = made("circle", 1.0)
    state, estimate = first_ticks(controller)
    with pytest.raises(ValueError, match="not finite"):
        control(controller, state, estimate._replace(**{field: value}), 10_000_000)


def test_a_start_on_the_crossing_takes_the_branch_the_car_heads_along() -> None:
    controller = made("figure8", 1.0)
    path = controller.keeper.path
    other = ORIGIN._replace(yaw=path.yaw[len(path.x) // 2])
    report = control(controller, start_controller(controller, other, 0), other, 0)[1]
    assert report.s == pytest.approx(path.length / 2.0, abs=path.step)
    assert abs(report.e2) < 0.01
