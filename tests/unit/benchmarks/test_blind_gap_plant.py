"""The hidden plant behaves like a car, and every defect shows and vanishes at its null."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind_gap.car import PlantCar, make_car
from benchmarks.blind_gap.drives import LEAD, make_noise, make_orders
from benchmarks.blind_gap.effects import EFFECTS, OUTSIDE, Place
from benchmarks.blind_gap.plant import STEP, TICK, Noise, Orders, simulate

pytestmark = pytest.mark.slow

SECONDS = 3.0


def quiet(seconds=SECONDS):
    n = LEAD + round(seconds / STEP)
    return Noise(np.zeros((n, 3)), np.zeros((n // TICK, 3)))


def constant(steer, speed, seconds=SECONDS):
    n = LEAD + round(seconds / STEP)
    ticks = n // TICK
    full = np.full
    return Orders(
        full(ticks, steer), full(ticks, speed), np.zeros((0, 3)), 2.0, np.zeros(n), np.zeros(n)
    )


def drive(car, orders, speed=None, noise=None):
    start = np.array([0.0, 0.0, 0.0, orders.speed[0] if speed is None else speed])
    return simulate(car, start, LEAD, orders, noise or quiet())


def eventful():
    rng = np.random.default_rng(4)
    return make_orders("rich", 6.0, rng)


def test_rest_stays_at_rest():
    rng = np.random.default_rng(0)
    trace = drive(make_car(rng), constant(0.2, 0.0), noise=make_noise(SECONDS, rng))
    assert np.all(trace.states == 0.0)


def test_straight_stays_straight():
    trace = drive(PlantCar(), constant(0.0, 2.0))
    assert np.abs(trace.states[:, [1, 2, 4, 5]]).max() < 1e-9
    assert trace.states[-1, 3] == pytest.approx(2.0, abs=1e-3)


def test_rolling_drag_is_the_deceleration_of_a_car_left_to_roll():
    car = EFFECTS["rolling_drag"].apply(PlantCar(), {"drag": 0.5})
    coasting = replace(constant(0.0, 3.0, 2.0), cut=np.ones(LEAD + 2000))
    speed = drive(car, coasting, noise=quiet(2.0)).states[:, 3]
    assert (speed[1000] - speed[2000]) / (1000 * STEP) == pytest.approx(0.5, rel=0.02)


def test_left_and_right_are_mirror_images():
    orders = eventful()
    left = drive(PlantCar(), orders, noise=quiet(6.0))
    right = drive(PlantCar(), replace(orders, steer=-orders.steer), noise=quiet(6.0))
    sign = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    assert np.abs(left.states[:, :6] - sign * right.states[:, :6]).max() < 1e-9
    swapped = right.states[:, [7, 6, 9, 8]]
    assert np.abs(left.states[:, 6:] - swapped).max() < 1e-9


def test_slow_circle_is_kinematic():
    car = PlantCar()
    state = drive(car, constant(0.1, 0.6), speed=0.6).states[-1]
    assert state[5] == pytest.approx(state[3] * np.tan(0.1) / (car.lf + car.lr), rel=0.02)


def test_fast_circle_understeers_as_the_stiffness_says():
    car = PlantCar()
    state = drive(car, constant(0.06, 2.0)).states[-1]
    speed = np.hypot(state[3], state[4])
    bend = 1.0 / car.stiff_front - 1.0 / car.stiff_rear
    base = car.lf + car.lr + speed**2 / (car.mu * 9.81) * bend
    assert state[5] == pytest.approx(speed * 0.06 / base, rel=0.03)


def test_grip_ends_at_the_ceiling():
    car = PlantCar()._replace(ceiling=0.3)
    states = drive(car, constant(0.3, 3.0)).states[LEAD:]
    across = np.gradient(states[:, 4], STEP) + states[:, 5] * states[:, 3]
    assert np.abs(across[1000:]).max() < 0.3 * car.mu * 9.81 * 1.1


def test_wheels_never_pull_more_than_the_motor_allows():
    states = drive(PlantCar()._replace(accel_max=2.0), constant(0.0, 3.0), speed=0.5).states
    assert np.diff(states[:, 3]).max() / STEP <= 2.0 * 1.05


@pytest.mark.parametrize("name", EFFECTS)
def test_effect_shows_and_its_null_does_not(name):
    effect, orders, noise = EFFECTS[name], eventful(), quiet(6.0)
    base = drive(PlantCar(), orders, noise=noise)
    place = Place(1.0, 0.7, float(base.states[3000, 0]), float(base.states[3000, 1]))
    null = drive(effect.apply(PlantCar(), effect.null), orders, noise=noise)
    assert np.array_equal(null.poses, base.poses)
    values = effect.values(effect.table[1], place)
    assert values.keys() == effect.null.keys() == effect.units.keys()
    changed = drive(effect.apply(PlantCar(), values), orders, noise=noise)
    assert np.abs(changed.poses - base.poses).max() > 2e-4


@pytest.mark.parametrize("name", [k for k, v in OUTSIDE.items() if not v.jitter])
def test_outside_defect_shows(name):
    kind, noise = OUTSIDE[name], quiet(6.0)
    strength, rng = kind.table[2], np.random.default_rng(4)
    orders = make_orders("rich", 6.0, rng)
    faulty = make_orders(
        "rich",
        6.0,
        np.random.default_rng(4),
        freeze=kind.freeze * strength,
        cut=kind.cut * strength,
    )
    base = drive(PlantCar(), orders, noise=noise)
    place = Place(1.0, 0.0, float(base.states[3000, 0]), float(base.states[3000, 1]))
    changed = drive(kind.apply(PlantCar(), strength, place), faulty, noise=noise)
    assert np.abs(changed.poses - base.poses).max() > 2e-3


NOT_HIDDEN = {"wheel_slip", "drive_split"}
"""What every hidden car has anyway: tyres that slip along as well, a driven front axle."""


def test_names_of_the_contract():
    import steerd.car_model.effects as library
    from steerd.car_model.effect import Role

    for name, effect in EFFECTS.items():
        known = library.EFFECTS[name]
        assert known.family == effect.family
        theirs = {p.name: p.unit for p in known.parameters}
        assert dict(effect.units).items() <= theirs.items()
        form = {p.name for p in known.parameters if p.role is Role.FORM}
        assert theirs.keys() - effect.units.keys() <= form  # the plant varies no form
        nulls = {p.name: p.null for p in known.parameters}
        assert nulls | dict(effect.null) == nulls
    assert set(library.EFFECTS) - set(EFFECTS) == NOT_HIDDEN
    assert not set(OUTSIDE) & (set(library.EFFECTS) | set(library.ALIASES))
