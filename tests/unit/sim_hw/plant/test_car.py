"""The plant: dead times, braking to rest, friction, history, and the model it must equal."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect, Stage
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import STATES
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, PAPER_CAR
from steerd.car_model.planar import CHASSIS, PLANAR
from steerd.car_model.rollout import start, step
from steerd.car_model.state import ORIGIN, Command
from steerd.sim_hw.plant.car import COAST, CarSetup, DelayLine, Demand, Drive, SimCar, make_steps
from steerd.sim_hw.plant.noise import make_noise_source

PLAIN = Model(DEFAULT_CAR)


def make_car(model=PLAIN, seed=0, **setup) -> SimCar:
    return SimCar(model, CarSetup(**setup), make_noise_source(seed, "car"))


def drive(car: SimCar, steps: int, demand: Demand) -> float:
    """Its speed after so many steps with straight wheels."""
    for _ in range(steps):
        car.step(0.0, demand)
    return car.state.speed


def test_brake_stops_within_computed_distance_or_grip_and_never_reverses():
    car = make_car(start=ORIGIN._replace(speed=3.0))
    speeds = [drive(car, 1, Demand(Drive.BRAKE, 3.4)) for _ in range(1500)]
    assert (min(speeds), speeds[-1]) == (0.0, 0.0)
    assert car.state.x == pytest.approx(3.0**2 / 2 / (3.4 + 0.6), rel=0.01)
    car = make_car(Model(DEFAULT_CAR._replace(mu=0.2)), start=ORIGIN._replace(speed=3.0))
    drive(car, 1, Demand(Drive.BRAKE, 50.0))
    assert car.accel_x == pytest.approx(-0.2 * 9.81, rel=1e-6)


def test_coasting_loses_speed_to_drag_alone_which_a_force_must_exceed_to_move_a_car_at_rest():
    car = make_car(start=ORIGIN._replace(speed=1.0))
    assert drive(car, 500, COAST) == pytest.approx(1.0 - 0.6, abs=1e-9)
    car = make_car()
    assert drive(car, 200, Demand(Drive.FORCE, 0.5)) == 0.0
    assert drive(car, 200, Demand(Drive.FORCE, -1.6)) == pytest.approx(-0.4, rel=0.02)


def test_brake_holds_on_a_slope_where_coasting_rolls():
    model = Model(DEFAULT_CAR, (EFFECTS["floor_slope"],), ((-0.15, 0.0, 0.0),))
    assert drive(make_car(model), 500, Demand(Drive.BRAKE, 3.4)) == 0.0
    assert abs(drive(make_car(model), 500, COAST)) > 0.3


def test_history_interpolates_and_pose_delay_looks_back():
    model = Model(DEFAULT_CAR._replace(pose_delay=0.1))
    car = make_car(model, start=ORIGIN._replace(speed=1.0))
    drive(car, 200, Demand(Drive.SPEED, 1.0))
    between = car.state_at(car.t_ns - 3_000_000)
    assert between.x == pytest.approx(car.state.x - 0.003, abs=1e-9)
    assert car.observe_pose(car.t_ns).x == pytest.approx(car.state.x - 0.1, abs=1e-9)
    assert car.state_at(-1).x <= car.state.x


def test_process_noise_is_seeded_and_leaves_a_resting_car_alone():
    def end(seed: int, speed: float) -> object:
        begun = ORIGIN._replace(speed=speed)
        car = make_car(seed=seed, process_noise=(0.1, 0.5, 0.1), start=begun)
        drive(car, 100, COAST if not speed else Demand(Drive.SPEED, speed))
        return car.state

    assert end(1, 1.0) == end(1, 1.0) != end(2, 1.0)
    assert end(1, 0.0) == ORIGIN


CHANGES = st.lists(st.tuples(st.integers(1, 3_000_000), st.floats(-5, 5)), min_size=1, max_size=30)


@given(delay=st.integers(0, 7_000_000), changes=CHANGES)
@settings(deadline=None, derandomize=True)
def test_delay_line_keeps_the_area_of_the_signal(delay, changes):
    line = DelayLine(delay, 0.0)
    t, area, held, step, read, out = 0, 0.0, 0.0, 2_000_000, 0, 0.0
    for gap, value in changes:
        area += held * gap
        t += gap
        held = value
        while read + step <= t:
            out += line.mean(read, read + step) * step
            read += step
        line.push(t, value)
    area += held * (60_000_000 - t) if t < 60_000_000 else 0.0
    end = max(60_000_000, t)
    while read < end + delay:
        out += line.mean(read, read + step) * step
        read += step
    assert out == pytest.approx(area + held * (read - end - delay), abs=1.0 + 1e-6 * abs(area))


# The compiled step is the model's own step on floats, with every effect of the library.
H = 0.002
CROOKED = PAPER_CAR._replace(steer_gain=0.9, steer_bias=0.02, speed_gain=1.07)


def assert_driven_alike(model: Model[float], count: int) -> None:
    """By the states, which are all that shows: memory is laid out otherwise in the library."""
    rng = np.random.default_rng(2)
    steps, begun = make_steps(model, H), ORIGIN._replace(speed=0.1)
    numbers, moment = (*begun, *[0.0] * steps.memory), start(model, begun, 0.0)
    for k in range(count):
        order = Command(*rng.uniform((-0.5, -1.0), (0.5, 4.0)).tolist())
        numbers = steps.follow(*numbers, *order, k * H)
        moment = step(FLOAT, model, moment, order, k * H, H)
        np.testing.assert_allclose(numbers[:STATES], moment.state, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("chassis", CHASSIS, ids=lambda chassis: chassis.label)
@pytest.mark.parametrize("car", [DEFAULT_CAR, CROOKED], ids=["straight", "crooked"])
def test_every_chassis_is_equal(chassis: Chassis, car) -> None:
    assert_driven_alike(Model(car, chassis=chassis), 500)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_is_equal(name: str) -> None:
    effect = EFFECTS[name]
    values = tuple(min(max(p.null + 0.7 * p.scale, p.low), p.high) for p in effect.parameters)
    assert_driven_alike(Model(DEFAULT_CAR, (effect,), (values,)), 150)


def test_a_step_is_its_two_halves_and_a_glide_its_parts() -> None:
    whole, half = (make_steps(Model(DEFAULT_CAR, chassis=PLANAR), h) for h in (H, H / 2.0))
    begun, order = (*ORIGIN._replace(speed=1.0, steer=0.05), *[0.0] * whole.memory), (0.2, 1.5, 0.0)
    end, accel = whole.actuate(*begun, *order)
    assert whole.glide(1, *begun, end, accel, 0.0) == whole.follow(*begun, *order)
    middle = half.glide(1, *begun, 0.5 * (0.05 + end), accel, 0.0)
    parts = half.glide(1, *middle, end, accel, 0.5 * H)
    assert whole.glide(2, *begun, end, accel, 0.0) == pytest.approx(parts, rel=1e-12)


def test_what_is_not_finite_is_an_error_and_an_effect_that_is_not_the_librarys() -> None:
    steps = make_steps(Model(DEFAULT_CAR), H)
    with pytest.raises(ValueError, match="no number"):
        steps.follow(0.0, 0.0, math.inf, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    effect = Effect("own", Stage.COMMAND, "steering", "", "", (), least_size=0.0)
    with pytest.raises(ValueError, match="without own"):
        make_steps(Model(DEFAULT_CAR, (effect,), ((),)), H)
