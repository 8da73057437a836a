"""The car in MuJoCo behind the interface of the simulated car."""

import math

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed (dependency group foreign)")

from benchmarks.foreign_cars.drives import make_plan
from benchmarks.foreign_cars.in_the_loop import LoopCar
from benchmarks.foreign_cars.mjcf import draw_car
from benchmarks.foreign_cars.mujoco_car import MujocoPlant, simulate
from benchmarks.foreign_cars.wiring import Wiring, make_orders
from steerd.sim_hw.plant.car import COAST, CarSetup, Demand, Drive


def loop_car(wiring: Wiring, pushed: bool = False) -> LoopCar:
    car = LoopCar(MujocoPlant(draw_car(False, np.random.default_rng(1)), wiring), CarSetup(), 3)
    if not pushed:
        car._push[:] = 0.0
    return car


def run(car: LoopCar, steer: float, speed: float, seconds: float) -> None:
    for _ in range(round(seconds / 2e-3)):
        car.step(steer, Demand(Drive.SPEED, speed))


def test_it_turns_as_the_batch_simulation_does():
    wiring = Wiring(steer_gain=0.95, steer_bias=0.01)
    car = loop_car(wiring)
    run(car, 0.0, 1.5, 1.0)
    run(car, 0.15, 1.5, 4.0)
    commands = make_plan(np.full(500, 0.15), np.full(500, 1.5))
    orders = make_orders(wiring, commands, np.random.default_rng(0))
    path = simulate(
        draw_car(False, np.random.default_rng(1)), wiring, orders,
        np.zeros((commands.steps, 3)), commands.start,
    )  # fmt: skip
    assert car.state.yaw_rate == pytest.approx(path.velocity[-1, 2], rel=5e-3)
    assert car.wheel_speed() == pytest.approx(path.rolling[-1], rel=5e-3)
    assert car.state.steer == pytest.approx(orders.angle[-1], rel=1e-6)


def test_dead_times_and_offsets_are_where_the_wiring_has_them():
    car = loop_car(Wiring(steer_delay=0.03, pose_delay=0.02, marker_x=0.04, marker_yaw=0.1))
    run(car, 0.0, 2.0, 2.0)
    began = car.t_ns
    run(car, 0.2, 2.0, 0.028)
    assert car.state.steer == 0.0
    run(car, 0.2, 2.0, 0.01)
    assert car.state.steer > 0.0
    seen, late = car.observe_pose(began), 0.02 * car.state.speed
    true = car.observe_pose(began + 20_000_000)
    assert math.hypot(true.x - seen.x, true.y - seen.y) == pytest.approx(late, rel=0.02)
    state = next(state for t, state in car._history if t == began)
    assert true.x - state.x == pytest.approx(0.04 * math.cos(state.yaw), abs=1e-6)
    assert true.yaw - state.yaw == pytest.approx(0.1)


def test_a_released_car_comes_to_rest_and_stays():
    car = loop_car(Wiring(), pushed=True)
    run(car, 0.1, 1.5, 1.5)
    for _ in range(1500):
        car.step(0.0, COAST)
    rest = car.state
    for _ in range(100):
        car.step(0.0, COAST)
    assert car.state == rest._replace(steer=car.state.steer)
    assert rest.speed == 0.0
