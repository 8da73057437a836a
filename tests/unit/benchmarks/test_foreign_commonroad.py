"""CommonRoad's car: the package's own equations, scaled rightly, driven by loops."""

import numpy as np
import pytest

pytest.importorskip(
    "vehiclemodels", reason="commonroad-vehicle-models is not installed (dependency group foreign)"
)

from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from benchmarks.blind_gap.car import GRAVITY
from benchmarks.foreign_cars.commonroad_car import (
    MASS,
    WHEELBASE,
    CommonRoadPlant,
    Floor,
    make_commonroad,
    make_vehicle,
    rolling_mass,
    simulate,
)
from benchmarks.foreign_cars.commonroad_rhs import STATES, as_tuple, rhs
from benchmarks.foreign_cars.drives import Commands, make_plan
from benchmarks.foreign_cars.wiring import Wiring, make_orders

ANGLES = [2, 4, 6, 8, 13, 18]
LENGTHS = [0, 1, 11, 16, 21, 27, 28]
SPEEDS = [3, 10, 12, 15, 17, 20, 22]
RATES = [5, 7, 9, 14, 19, 23, 24, 25, 26]


def a_plant(floor: Floor | None = None) -> CommonRoadPlant:
    car = make_vehicle()
    return CommonRoadPlant(car, floor or Floor(), Wiring(), rolling_mass(car))


def quiet(plant: CommonRoadPlant, commands: Commands) -> np.ndarray:
    """A drive without disturbances."""
    orders = make_orders(plant.wiring, commands, np.random.default_rng(0))
    return simulate(plant, orders, np.zeros((commands.steps, 3)), commands.start)


def circle(steer: float, speed: float, ticks: int = 500) -> Commands:
    return make_plan(np.where(np.arange(ticks) < 50, 0.0, steer), np.full(ticks, speed))


def some_state(parameters: object, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    start = [1.0, 2.0, 0.05, 9.0 + rng.uniform(), 0.4, 0.5 * rng.standard_normal(), 0.03]
    state = np.array(init_mb(start, parameters), float)
    return state * (1.0 + 0.02 * rng.standard_normal(STATES)) + 1e-3 * rng.standard_normal(STATES)


def test_the_compiled_equations_are_the_packages() -> None:
    parameters = setup_vehicle_parameters(2)
    small = as_tuple(parameters)
    for seed, inputs in enumerate([(0.1, 2.0), (-0.3, -3.0), (0.0, 0.0)]):
        state = some_state(parameters, seed)
        ours = rhs(state.copy(), np.array(inputs), small)
        theirs = vehicle_dynamics_mb(list(state), list(inputs), parameters)
        np.testing.assert_array_equal(ours, theirs)


def test_the_small_car_moves_as_the_big_one_in_scaled_time() -> None:
    parameters = setup_vehicle_parameters(2)
    big = as_tuple(parameters)._replace(T_sb=0.0, T_se=0.0)
    small = make_vehicle()
    length = WHEELBASE / (big.a + big.b)
    time = np.sqrt(length)
    factors = np.ones(STATES)
    factors[LENGTHS], factors[SPEEDS], factors[RATES] = length, length / time, 1.0 / time
    assert sorted(ANGLES + LENGTHS + SPEEDS + RATES) == list(range(STATES))
    for seed in range(3):
        state = some_state(parameters, seed)
        large = np.array(rhs(state.copy(), np.array([0.2, 1.5]), big))
        little = np.array(rhs(state * factors, np.array([0.2 / time, 1.5]), small))
        np.testing.assert_allclose(little, large * factors / time, rtol=1e-6, atol=1e-6)
    assert small.m == pytest.approx(MASS)


def test_a_slow_circle_is_nearly_kinematic() -> None:
    plant = a_plant()
    last = quiet(plant, circle(0.2, 0.8))[-1000:].mean(axis=0)
    speed = np.hypot(last[3], last[10])
    curvature = np.tan(0.2) / (plant.car.a + plant.car.b)
    assert last[5] / speed / curvature == pytest.approx(1.0, abs=0.05)


def test_lateral_acceleration_stays_below_the_friction_limit() -> None:
    last = quiet(a_plant(), circle(0.3, 3.5))[-1000:].mean(axis=0)
    bound = a_plant().car.tire.p_dy1 * GRAVITY
    # Camber adds a little to the package's friction.
    assert 0.7 * bound < abs(last[5] * last[3]) < 1.1 * bound


def test_a_car_without_motor_loses_energy_at_the_rate_of_its_drag() -> None:
    plant = a_plant(Floor(drag=0.4))
    plan = make_plan(np.zeros(300), np.full(300, 2.0))
    orders = make_orders(plant.wiring, plan, np.random.default_rng(0))
    off = orders._replace(cut=np.ones(plan.steps))
    states = simulate(plant, off, np.zeros((plan.steps, 3)), plan.start)
    speed = states[200::100, 3]
    assert (np.diff(speed) < 0.0).all()
    slowing = (speed[0] - speed[-1]) / (0.1 * (len(speed) - 1))
    assert slowing == pytest.approx(0.4, rel=0.1)


def test_half_the_step_gives_the_same_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = a_plant()
    steer = 0.25 * np.sin(np.arange(100) / 8.0)
    plan = make_plan(steer, np.full(100, 2.5))
    orders = make_orders(plant.wiring, plan, np.random.default_rng(0))
    from benchmarks.foreign_cars import commonroad_car

    coarse = simulate(plant, orders, np.zeros((plan.steps, 3)), plan.start)
    monkeypatch.setattr(commonroad_car, "PARTS", 2 * commonroad_car.PARTS)
    fine = simulate(plant, orders, np.zeros((plan.steps, 3)), plan.start)
    assert not np.array_equal(coarse, fine)
    np.testing.assert_allclose(coarse[:, [0, 1, 4]], fine[:, [0, 1, 4]], atol=2e-3)


def test_effects_of_the_car_change_their_own_numbers_only() -> None:
    plant = make_commonroad(np.random.default_rng(2))
    changed = {
        "mass": ({"payload": 0.7}, {"m", "m_s"}),
        "yaw_inertia": ({"ratio": 1.3}, {"I_z"}),
        "cog_offset": ({"offset": 0.02}, {"a", "b"}),
        "tyre_friction": ({"ratio": 0.8}, {"tire"}),
        "cornering_stiffness": ({"ratio": 0.8}, {"tire"}),
        "rolling_drag": ({"drag": 0.4}, set()),
    }
    for effect, (values, fields) in changed.items():
        ill = plant.with_effect(effect, values)
        differing = {
            name for name in plant.car._fields if getattr(ill.car, name) != getattr(plant.car, name)
        }
        assert differing == fields, effect
    rubbed = plant.with_effect("rolling_drag", {"drag": 0.4}).floor.drag
    assert rubbed == pytest.approx(plant.floor.drag + 0.4)
    assert plant.with_effect("yaw_inertia", {"ratio": 1.3}).truth["inertia_z"] == pytest.approx(
        1.3 * plant.truth["inertia_z"]
    )
