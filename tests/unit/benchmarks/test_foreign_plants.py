"""What holds for every foreign car: seeds, effects at their nulls and at work, the log's frame."""

import numpy as np
import pytest

from benchmarks.blind_gap.effects import EFFECTS, Place
from benchmarks.foreign_cars.drives import make_commands, make_plan
from benchmarks.foreign_cars.effects import label_of, strength_of
from benchmarks.foreign_cars.log import Log
from benchmarks.foreign_cars.plants import PLANTS, MissingPlantError, Plant, drive, make_plant

TICKS = 200
PLACE = Place(1.0, 0.7, 0.0, 0.0)


def plant_of(name: str, seed: int = 3) -> Plant:
    try:
        return make_plant(name, seed)
    except MissingPlantError as error:
        pytest.skip(str(error))


def short_drive(plant: Plant, seed: int = 5, ticks: int = TICKS) -> Log:
    """A slalom to both end stops, a speed step up and one down."""
    at = np.arange(ticks)
    steer = 0.33 * np.sin(at / 18.0)
    return drive(plant, make_plan(steer, np.where((at > 30) & (at < 120), 2.8, 1.2)), seed)


def same(a: Log, b: Log) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("t", "poses", "commands", "wheel")
    )


@pytest.mark.parametrize("name", PLANTS)
def test_a_seed_is_a_drive(name: str) -> None:
    plant = plant_of(name)
    first = short_drive(plant)
    assert same(first, short_drive(plant))
    assert not np.array_equal(first.poses, short_drive(plant, seed=6).poses)
    assert not np.array_equal(first.poses, short_drive(plant_of(name, seed=4)).poses)


@pytest.mark.parametrize("name", PLANTS)
def test_a_log_is_what_the_import_wants(name: str) -> None:
    commands = make_commands("rich", 3.0, np.random.default_rng(1))
    log = drive(plant_of(name), commands, 5)
    assert len(log.t) == 300
    assert log.t[0] == 0.0
    np.testing.assert_allclose(np.diff(log.t), 0.01, atol=1e-9)
    moved = np.diff(log.poses[:, :2], axis=0)
    along = np.cos(log.poses[1:, 2]) * moved[:, 0] + np.sin(log.poses[1:, 2]) * moved[:, 1]
    # Forward is x of the body, and the wheels report nearly the speed over ground.
    assert np.median(along / 0.01 / log.wheel[1:]) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("name", PLANTS)
def test_effects_at_their_nulls_change_nothing(name: str) -> None:
    plant = plant_of(name)
    healthy = short_drive(plant)
    for effect in sorted(plant.effects):
        plant = plant.with_effect(effect, dict(EFFECTS[effect].null))
    null = short_drive(plant)
    np.testing.assert_allclose(null.poses, healthy.poses, atol=1e-6)
    np.testing.assert_allclose(null.wheel, healthy.wheel, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_every_effect_and_defect_changes_the_drive(name: str) -> None:
    plant = plant_of(name)
    healthy = short_drive(plant)
    for effect in sorted(plant.effects):
        ill = short_drive(plant.with_effect(effect, label_of(effect, "large", PLACE)))
        assert np.abs(ill.poses - healthy.poses).max() > 1e-4, effect
        np.testing.assert_array_equal(ill.commands, healthy.commands)
    # The first drop-out of the motor may come after three seconds.
    healthy = short_drive(plant, ticks=360)
    for defect in sorted(plant.outside):
        ill = plant.with_outside(defect, strength_of(defect, "large"), PLACE)
        broken = short_drive(ill, ticks=360)
        changes = [np.abs(broken.poses - healthy.poses).max(), np.abs(broken.t - healthy.t).max()]
        assert max(changes) > 1e-4, defect


@pytest.mark.parametrize("name", PLANTS)
def test_effects_of_the_sensor_leave_the_car_alone(name: str) -> None:
    plant = plant_of(name)
    healthy = short_drive(plant)
    turned = short_drive(plant.with_effect("mocap_yaw", {"offset": 0.02}))
    np.testing.assert_allclose(turned.poses - healthy.poses, [[0.0, 0.0, 0.02]] * TICKS, atol=1e-9)
    moved = short_drive(plant.with_effect("marker_offset", {"forward": 0.03, "left": -0.01}))
    shift = moved.poses[:, :2] - healthy.poses[:, :2]
    np.testing.assert_allclose(np.hypot(*shift.T), np.hypot(0.03, 0.01), atol=1e-9)
    late = short_drive(plant.with_effect("mocap_latency", {"latency": 0.05}))
    # Five ticks late, up to the noise of two poses.
    assert np.abs(late.poses[5:, 2] - healthy.poses[:-5, 2]).max() < 0.02
    for seen in (turned, moved, late):
        np.testing.assert_array_equal(seen.wheel, healthy.wheel)


@pytest.mark.parametrize("name", PLANTS)
def test_a_late_steering_turns_late_by_as_much(name: str) -> None:
    plant = plant_of(name)
    steer = np.where(np.arange(300) < 100, 0.0, 0.2)
    plan = make_plan(steer, np.full(300, 1.5))

    def turns_at(car: Plant) -> float:
        yaw = drive(car, plan, 2).poses[:, 2]
        return float(np.interp(yaw[0] + 0.4, np.maximum.accumulate(yaw), np.arange(300)))

    late = turns_at(plant.with_effect("steer_delay", {"delay": 0.06})) - turns_at(plant)
    # The same pushes act on both, on slightly different states.
    assert late == pytest.approx(6.0, abs=1.5)
