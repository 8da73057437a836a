"""Physics of the car in MuJoCo, on tyres with a slip angle and on MuJoCo's own contacts."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed (dependency group foreign)")

from benchmarks.blind_gap.car import GRAVITY
from benchmarks.foreign_cars.drives import LEAD_TICKS, Commands, make_plan
from benchmarks.foreign_cars.mjcf import MujocoCar, draw_car, make_model, rest_loads, yaw_inertia
from benchmarks.foreign_cars.mujoco_car import MujocoPlant, Path, make_mujoco, simulate
from benchmarks.foreign_cars.wiring import Wiring, make_orders

KINDS = pytest.mark.parametrize("contact", [False, True], ids=["slip", "contact"])


def quiet(car: MujocoCar, commands: Commands, wiring: Wiring | None = None) -> Path:
    """A drive without disturbances."""
    wiring = wiring or Wiring()
    orders = make_orders(wiring, commands, np.random.default_rng(0))
    return simulate(car, wiring, orders, np.zeros((commands.steps, 3)), commands.start)


def a_car(contact: bool, seed: int = 1) -> MujocoCar:
    return draw_car(contact, np.random.default_rng(seed))


def circle(steer: float, speed: float, ticks: int = 500) -> Commands:
    angles = np.where(np.arange(ticks) < 50, 0.0, steer)
    return make_plan(angles, np.full(ticks, speed))


def steady(path: Path) -> tuple[float, float]:
    """Speed [m/s] and yaw rate [rad/s] of the last second."""
    return float(np.hypot(*path.velocity[-1000:, :2].T).mean()), float(
        path.velocity[-1000:, 2].mean()
    )


@KINDS
def test_the_model_has_the_mass_inertia_and_loads_of_its_numbers(contact: bool) -> None:
    car = a_car(contact)
    model = make_model(car, 0.1, 5.0)
    assert model.body_mass.sum() == pytest.approx(car.mass)
    assert yaw_inertia(model) == pytest.approx(car.inertia_z, rel=1e-9)
    path = quiet(car, make_plan(np.zeros(200), np.full(200, 1.0)))
    np.testing.assert_allclose(path.loads[-1], rest_loads(car), rtol=0.02)


@KINDS
def test_left_is_the_mirror_of_right(contact: bool) -> None:
    car = a_car(contact)
    steer = 0.2 * np.sin(np.arange(200) / 15.0)
    speed = np.where(np.arange(200) < 100, 1.5, 2.2)
    left, right = (quiet(car, make_plan(s * steer, speed)) for s in (1.0, -1.0))
    np.testing.assert_allclose(left.poses[:, 0], right.poses[:, 0], atol=5e-3)
    np.testing.assert_allclose(left.poses[:, 1:], -right.poses[:, 1:], atol=5e-3)


@KINDS
def test_a_slow_circle_is_nearly_kinematic(contact: bool) -> None:
    car = a_car(contact)
    speed, rate = steady(quiet(car, circle(0.2, 0.8)))
    assert speed * np.tan(0.2) / (car.lf + car.lr) / rate == pytest.approx(1.0, abs=0.06)


@KINDS
def test_a_fast_circle_is_wider_and_stays_below_the_friction_limit(contact: bool) -> None:
    car = a_car(contact)
    slow = steady(quiet(car, circle(0.3, 0.8)))
    fast = steady(quiet(car, circle(0.3, 3.0)))
    assert fast[1] / fast[0] < slow[1] / slow[0]
    bound = car.tyre.mu * GRAVITY
    assert 0.6 * bound < fast[0] * fast[1] < 1.02 * bound
    wild = quiet(car, circle(0.33, 5.0, 200)).velocity[::20, :2]
    assert np.hypot(*np.diff(wild, axis=0).T).max() / 0.02 < 1.15 * bound


@KINDS
def test_load_moves_to_the_outer_wheels_and_to_the_rear(contact: bool) -> None:
    car = a_car(contact)
    loads = quiet(car, circle(0.2, 2.0)).loads[-1000:].mean(axis=0)
    assert loads[1] > loads[0]
    assert loads[3] > loads[2]
    speeds = np.where(np.arange(150) < 100, 1.0, 3.0)
    hard = quiet(car, make_plan(np.zeros(150), speeds)).loads
    pulling = hard[(LEAD_TICKS + 100) * 10 + 150 : (LEAD_TICKS + 100) * 10 + 300].mean(axis=0)
    assert pulling[2:].sum() > rest_loads(car)[2:].sum() + 0.5


@KINDS
def test_a_car_without_motor_loses_energy_at_the_rate_of_its_drag(contact: bool) -> None:
    car = a_car(contact)
    plan = make_plan(np.zeros(300), np.full(300, 2.0))
    orders = make_orders(Wiring(), plan, np.random.default_rng(0))
    off = orders._replace(cut=np.ones(plan.steps))
    path = simulate(car, Wiring(), off, np.zeros((plan.steps, 3)), plan.start)
    speed = path.velocity[200::100, 0]
    assert (np.diff(speed) < 0.0).all()
    slowing = (speed[0] - speed[-1]) / (0.1 * (len(speed) - 1))
    assert slowing == pytest.approx(car.drag, rel=0.25)


@KINDS
def test_acceleration_is_limited_as_the_motor_is(contact: bool) -> None:
    car = a_car(contact)
    plan = make_plan(np.zeros(200), np.where(np.arange(200) < 50, 0.8, 3.0))
    for limit in (2.0, 4.0):
        path = quiet(car, plan, Wiring(accel_max=limit, brake_max=limit))
        pull = np.diff(path.velocity[::50, 0]) / 0.05
        assert pull.max() == pytest.approx(limit, rel=0.12)


@KINDS
def test_effects_of_the_car_change_their_own_numbers_only(contact: bool) -> None:
    plant = make_mujoco(contact, np.random.default_rng(2))
    changed = {
        "mass": ({"payload": 0.7}, {"payload"}),
        "yaw_inertia": ({"ratio": 1.3}, {"inertia_z"}),
        "cog_offset": ({"offset": 0.02}, {"lf", "lr"}),
        "tyre_friction": ({"ratio": 0.8}, {"tyre"}),
        "rolling_drag": ({"drag": 0.4}, {"drag"}),
        "scrub": ({"yaw_damping": 2.0, "drag": 0.0}, {"differential"}),
        "floor_slope": ({"x": 0.01, "y": 0.0}, {"slope_x"}),
    }
    for effect, (values, fields) in changed.items():
        ill = plant.with_effect(effect, values)
        assert isinstance(ill, MujocoPlant)
        differing = {
            name for name in MujocoCar._fields if getattr(ill.car, name) != getattr(plant.car, name)
        }
        assert differing == fields, effect
    heavier = plant.with_effect("mass", {"payload": 0.7})
    model, heavy = (make_model(p.car, 0.1, 5.0) for p in (plant, heavier))
    assert heavy.body_mass.sum() - model.body_mass.sum() == pytest.approx(0.7)
    assert yaw_inertia(heavy) == pytest.approx(yaw_inertia(model), rel=1e-6)


@KINDS
def test_softer_tyres_need_more_slip(contact: bool) -> None:
    plant = make_mujoco(contact, np.random.default_rng(2))

    def slip(p: MujocoPlant) -> float:
        path = quiet(p.car, circle(0.15, 2.5))
        course = np.arctan2(path.velocity[-1, 1], path.velocity[-1, 0])
        beta = np.angle(np.exp(1j * (course - path.poses[-1, 2])))
        return float(p.car.lr * path.velocity[-1, 2] / 2.5 - beta)

    softer = plant.with_effect("cornering_stiffness", {"ratio": 0.65})
    assert isinstance(softer, MujocoPlant)
    assert slip(softer) / slip(plant) == pytest.approx(1.0 / 0.65, rel=0.15)


def test_a_slope_turns_with_the_heading_not_with_the_car() -> None:
    car = a_car(False)._replace(slope_y=0.017)
    for yaw in (0.0, np.pi):
        plan = make_plan(np.zeros(200), np.full(200, 1.0), np.array([0.0, 0.0, yaw, 1.0]))
        assert quiet(car, plan).poses[-1, 1] > 0.005


def test_a_patch_takes_grip_where_it_is() -> None:
    car = a_car(False)
    slippery = car._replace(patch_x=0.0, patch_y=0.0, patch_radius=100.0, patch_drop=0.5)
    elsewhere = slippery._replace(patch_x=500.0)
    plan = circle(0.33, 4.0, 300)
    on, off, none = (quiet(c, plan) for c in (slippery, elsewhere, car))
    assert abs(steady(on)[1]) < 0.75 * abs(steady(none)[1])
    np.testing.assert_array_equal(off.poses, none.poses)
