"""The simulated car of its own: a file, or what a seed hides; and what sessions say of it."""

from dataclasses import replace
from pathlib import Path

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.assembly.build import make_plan, make_world_config
from steerd.daemon.assembly.session_meta import make_attachments, make_metadata
from steerd.daemon.assembly.sim_car import (
    BIAS,
    SHARES,
    compare_truths,
    load_sim_car,
    read_origin,
    read_true_car,
)
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.run_options import RunOptions, encode_options

CAR_FILE = Path(__file__).resolve().parents[4] / "config" / "f1tenth.toml"


def make(sim_car="", effects=(), **more):
    options = RunOptions("", path="line", simulated=True, sim_car=sim_car, effects=effects, **more)
    return make_plan(options, design=False)


def meta(plan):
    return make_metadata(plan, 1, 1, leased=False, reproducible=True)


def test_a_seed_hides_one_car_and_another_seed_another():
    one, same, other = (load_sim_car(f"hidden:{seed}").file.car for seed in (3, 3, 4))
    assert one == same != other


@pytest.mark.parametrize("seed", range(12))
def test_a_hidden_car_is_off_by_as_much_as_a_real_one(seed):
    car = load_sim_car(f"hidden:{seed}").file.car
    for name, share in SHARES.items():
        ratio = getattr(car, name) / getattr(DEFAULT_CAR, name)
        assert 1.0 - share - 1e-3 <= ratio <= 1.0 + share + 1e-3, name
    assert BIAS[0] - 1e-4 <= abs(car.steer_bias) <= BIAS[1] + 1e-4
    assert (car.lf, car.lr, car.mass) == (DEFAULT_CAR.lf, DEFAULT_CAR.lr, DEFAULT_CAR.mass)


@pytest.mark.parametrize("spec", ["hidden:", "hidden:-1", "hidden:x"])
def test_a_seed_is_a_whole_number(spec):
    with pytest.raises(SteerdError) as caught:
        load_sim_car(spec)
    assert caught.value.code == ExitCode.USAGE
    assert "hidden:7" in caught.value.hint


def test_the_car_file_is_the_controllers_and_the_other_one_is_driven(tmp_path):
    heavy = tmp_path / "heavy.toml"
    heavy.write_text(CAR_FILE.read_text().replace("steer_bias = 0.0", "steer_bias = 0.02"))
    plan = make(str(heavy), ("steer_lag=0.02",))
    world = make_world_config(plan)
    assert world.car.steer_bias == 0.02
    assert [effect.name for effect in world.effects] == ["steer_lag"]
    assert plan.settings.file.car.steer_bias == 0.0
    assert make_attachments(plan)["sim_car.toml"] == heavy.read_text()


def test_a_session_tells_its_true_car_and_how_to_drive_it_again():
    plan = make("hidden:5")
    assert read_true_car(meta(plan)) == plan.sim.file.car != plan.settings.file.car
    assert read_origin(meta(plan)) == "--sim --fast --sim-car hidden:5"
    assert read_origin(meta(make())) == "--sim --fast"
    assert read_origin({"steerd.session": {"mode": "import"}}) == ""


def test_a_car_is_driven_again_through_its_own_port_and_mocap():
    options = RunOptions("gone.toml", port="/dev/vesc", mocap="vrpn://lab/my car")
    found = {"steerd.session": {"options": encode_options(options)}}
    assert read_origin(found) == "--port /dev/vesc --mocap 'vrpn://lab/my car'"


def test_effects_go_with_the_simulated_car_and_not_with_a_file_that_has_them():
    found = meta(make(effects=("steer_lag=0.02",)))
    assert read_origin(found) == "--sim --fast --effect steer_lag=0.02"
    assert read_origin(found, own_car=False) == "--sim --fast"


def test_sessions_of_different_true_cars_are_told_apart():
    same = {"a": meta(make("hidden:5")), "b": meta(make("hidden:5"))}
    assert compare_truths(same) == []
    late = {"a": meta(make()), "b": meta(make(effects=("steer_delay=0.05",)))}
    (said,) = compare_truths(late)
    assert "a and b were driven on different simulated cars" in said
    assert "steer_delay.delay unset and 0.05" in said
    (said,) = compare_truths({"a": meta(make()), "b": meta(make("hidden:5"))})
    assert "more" in said


def test_a_car_on_the_floor_has_no_known_truth():
    plan = make("hidden:5")
    real = replace(plan, options=replace(plan.options, simulated=False, sim_car=""))
    assert "steerd.truth" not in meta(real)
    assert read_true_car(meta(real)) is None
    assert compare_truths({"a": meta(real), "b": meta(plan)}) == []


def test_an_old_session_was_driven_on_its_car_file():
    old = meta(make())
    del old["steerd.truth"]
    assert read_true_car(old) == make().settings.file.car
