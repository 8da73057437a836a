"""What a run is assembled of: its simulated car, and what its session says."""

import subprocess
import sys
from dataclasses import replace

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.assembly import session_meta, sim_car
from steerd.daemon.assembly.build import RunId, make_design_car, make_plan, make_world_config
from steerd.daemon.assembly.plans import parse_box
from steerd.daemon.assembly.session_meta import make_attachments, make_metadata
from steerd.daemon.assembly.sim_car import compare_truths, load_sim_car, read_origin, read_true_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.run_options import RunOptions, decode_options


# The simulated car: a file, or what a seed hides; and what sessions say of it.
def make(sim_car="", effects=(), **more):
    options = RunOptions("", path="line", simulated=True, sim_car=sim_car, effects=effects, **more)
    return make_plan(options, design=False)


def test_a_seed_hides_one_car_and_another_seed_another():
    one, same, other = (load_sim_car(f"hidden:{seed}").file.car for seed in (3, 3, 4))
    assert one == same != other


@pytest.mark.parametrize("seed", range(12))
def test_a_hidden_car_is_off_by_as_much_as_a_real_one(seed):
    car = load_sim_car(f"hidden:{seed}").file.car
    for name, share in sim_car.SHARES.items():
        ratio = getattr(car, name) / getattr(DEFAULT_CAR, name)
        assert 1.0 - share - 1e-3 <= ratio <= 1.0 + share + 1e-3, name
    assert sim_car.BIAS[0] - 1e-4 <= abs(car.steer_bias) <= sim_car.BIAS[1] + 1e-4
    assert (car.lf, car.lr, car.mass) == (DEFAULT_CAR.lf, DEFAULT_CAR.lr, DEFAULT_CAR.mass)


@pytest.mark.parametrize("spec", ["hidden:", "hidden:-1", "hidden:x"])
def test_a_seed_is_a_whole_number(spec):
    with pytest.raises(SteerdError) as caught:
        load_sim_car(spec)
    assert caught.value.code == ExitCode.USAGE
    assert "hidden:7" in caught.value.hint


def test_the_car_file_is_the_controllers_and_the_other_one_is_driven(tmp_path):
    heavy = tmp_path / "heavy.toml"
    text = default_car_path().read_text().replace("steer_bias = 0.0", "steer_bias = 0.02")
    heavy.write_text(text)
    plan = make(str(heavy), ("steer_lag=0.02",))
    world = make_world_config(plan)
    assert world.model.car.steer_bias == 0.02
    assert [effect.name for effect in world.model.effects] == ["tyre_saturation", "steer_lag"]
    assert plan.settings.file.car.steer_bias == 0.0
    assert make_attachments(plan)["sim_car.toml"] == text


def test_a_session_tells_its_true_car_and_how_to_drive_it_again():
    plan = make("hidden:5")
    assert read_true_car(make_metadata(plan)) == plan.sim.file.car != plan.settings.file.car
    assert read_origin(make_metadata(plan)) == "--sim --fast --sim-car hidden:5"
    assert read_origin(make_metadata(make())) == "--sim --fast"
    assert read_origin({"steerd.session": {"mode": "import"}}) == ""
    found = make_metadata(make(effects=("steer_lag=0.02",)))
    assert read_origin(found) == "--sim --fast --effect steer_lag=0.02"
    assert read_origin(found, own_car=False) == "--sim --fast", "a file that has them"


def test_sessions_of_different_true_cars_are_told_apart():
    same = {"a": make_metadata(make("hidden:5")), "b": make_metadata(make("hidden:5"))}
    assert compare_truths(same) == []
    late = {"a": make_metadata(make()), "b": make_metadata(make(effects=("steer_delay=0.05",)))}
    (said,) = compare_truths(late)
    assert "a and b were driven on different simulated cars" in said
    assert "steer_delay.delay unset and 0.05" in said
    (said,) = compare_truths({"a": make_metadata(make()), "b": make_metadata(make("hidden:5"))})
    assert "more" in said


def test_a_car_on_the_floor_has_no_known_truth():
    plan = make("hidden:5")
    real = replace(plan, options=replace(plan.options, simulated=False, sim_car=""))
    assert "steerd.truth" not in make_metadata(real)
    assert read_true_car(make_metadata(real)) is None
    assert compare_truths({"a": make_metadata(real), "b": make_metadata(plan)}) == []


# Plans: what is refused before anything starts, and what the design may count on.
def test_a_drills_box_becomes_the_fence_and_a_design_counts_on_the_limited_steering_only():
    settings = make(drill="mixed;open;speed=1;box=9").settings
    assert settings.thresholds.fence == parse_box("9").fence
    tight = replace(settings, limits=replace(settings.limits, steer_left_max=0.1))
    car = make_design_car(tight)
    assert car.steer_max == 0.1
    assert car.steer_min == make_design_car(settings).steer_min


# What a session file says of its run: name, metadata, attachments.
def test_a_session_is_named_by_date_car_and_run_in_the_right_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    path = session_meta.session_path(make().options, 1_700_000_000 * 10**9, 0x1_2345_6789)
    assert path == tmp_path / "sessions" / "2023-11-14T22-13-20Z_car1_23456789.mcap"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert session_meta.sessions_folder() == tmp_path / "steerd" / "sessions"


def test_reproducible_metadata_say_nothing_of_the_machine():
    plan = make()
    plain, same = (make_metadata(replace(plan, real=RunId(3, 4, leased=True))), make_metadata(plan))
    lost = set(plain["steerd.session"]) - set(same["steerd.session"])
    assert {"host", "kernel"} <= lost <= {"host", "kernel", "git"}
    session = plain["steerd.session"]
    assert (session["boot_id"], session["epoch_ns"], session["leased"]) == ("3", "4", "1")
    assert session["mode"] == "sim"
    assert decode_options(session["options"]) == plan.options


def test_car_file_and_path_file_are_attached_unchanged(tmp_path):
    plan = make()
    lane = tmp_path / "lane.csv"
    lane.write_text("x,y\n0,0\n1,0\n")
    with_file = replace(plan, options=replace(plan.options, path=f"csv:{lane},closed"))
    assert make_attachments(plan) == {"car.toml": plan.settings.file.text}
    assert make_attachments(with_file)["path.csv"] == lane.read_text()


def test_a_start_does_without_python_control():
    code = (
        "import sys\n"
        "from steerd.daemon.assembly.build import make_plan\n"
        "from steerd.daemon.settings.run_options import RunOptions\n"
        "make_plan(RunOptions('', path='circle:radius=3', simulated=True)).controller\n"
        "print(*{'control', 'matplotlib', 'torch'} & set(sys.modules))\n"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).split() == []
