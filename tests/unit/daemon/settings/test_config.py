"""Settings of a car file: the default is valid, wrong ones are named, edits keep its comments."""

import tomllib
from math import inf, nan, nextafter
from pathlib import Path

import msgspec
import pytest
import tomlkit

from steerd.car_model.car_file import default_car_path, load_car, parse_car
from steerd.controller.limits import LimitError
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.settings.car_edit import edit_car, make_car_values, read_vesc_yaml
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.thresholds import BOUNDS, Thresholds
from steerd.mocap_link.gates import GateConfig
from steerd.vesc_link.scaling import F1TENTH

DEFAULT = default_car_path().read_text()


def test_what_is_printed_is_the_commented_default_and_passes_the_check(tmp_path, cli):
    printed = cli("config").out
    assert printed == DEFAULT
    assert max(map(len, printed.splitlines())) <= 80
    path = tmp_path / "car.toml"
    path.write_text(printed)
    shown = cli("config", "--check", path).out
    assert "wheelbase 0.3302 m" in shown
    assert "4614 ERPM per m/s" in shown
    assert "the servo reaches 18.0° and 15.1°" in shown
    assert "tolerates 175 ms more delay" in " ".join(shown.split())
    assert max(len(line) for line in shown.replace(str(path), "car.toml").splitlines()) <= 80


def text_with(section, **values):
    """The default car file with other values in a section."""
    document = tomlkit.parse(DEFAULT)
    document.setdefault(section, tomlkit.table()).update(values)
    return tomlkit.dumps(document)


def settings_with(section, **values):
    return make_settings(parse_car(text_with(section, **values), Path("car.toml")))


@pytest.mark.parametrize(("section", "values", "said"), [
    ("car", {"mass": -1.0}, "car.mass"), ("car", {"masss": 3.74}, "did you mean mass?"),
    ("cra", {}, "did you mean [car]?"), ("limit", {}, "did you mean [limits]?"),
    ("controller", {"speed": 9.5}, "speed_max"),
    ("vesc", {"erpm_gian": 4614.0}, "[vesc]: erpm_gian is not a setting; did you mean"),
    ("vesc", {"servo_max": 0.1}, "[vesc]: servo limits"),
    ("vesc", {"brake_current_a": 0.0}, "[vesc]: brake_current_a = 0.0: a stop needs"),
    ("safety", {"jump_speed": 9}, "[safety]: jump_speed = 9 m/s is outside 1..8 m/s: the car"),
    ("safety", {"late_run": 4}, "[safety]: late_run = 4 ticks is outside 1..3 ticks"),
    ("safety", {"out_queue": 9}, "[safety]: out_queue = 9 B is outside 64..256 B"),
    ("safety", {"jump_frames": True}, "[safety]: Expected `int`, got `bool`"),
    ("record", {"flush_ms": 9}, "[record]: flush_ms = 9: 10 to 250 ms"),
    ("record", {"flush_ms": 251}, "[record]: flush_ms = 251: 10 to 250 ms"),
    ("record", {"requires": True}, "did you mean required?"),
    ("record", {"disk_free_min_mb": 99}, "at least 100 MB"),
])  # fmt: skip
def test_what_a_car_file_cannot_say_is_named(tmp_path, cli, section, values, said):
    path = tmp_path / "car.toml"
    path.write_text(text_with(section, **values))
    assert said in cli("config", "--check", path, code=ExitCode.INVALID).err


def test_a_car_file_replaces_thresholds_and_gates_let_the_noise_of_a_localiser_pass():
    settings = settings_with("safety", jump_speed=5, deadman=False)
    assert (settings.thresholds.jump_speed, settings.deadman) == (5.0, False)
    assert settings.thresholds.jump_frames == 3
    assert settings.ingest.gates == GateConfig()
    noisy = settings_with("estimator", pose_position_sd=0.02, pose_yaw_sd=0.02)
    gates = noisy.ingest.gates
    assert (gates.jump_slack, gates.yaw_slack) == pytest.approx((0.14, 0.14))


# Thresholds of `docs/reference/safety-requirements.md#s4`: bounds that no car file lifts.
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))


@pytest.mark.parametrize("name", BOUNDS)
def test_thresholds_hold_their_bounds_exactly(name):
    bound = BOUNDS[name]
    for value in (bound.low, bound.high):
        assert getattr(Thresholds(**{name: value}), name) == value
    for value in (nextafter(bound.low, -inf), nextafter(bound.high, inf), nan):
        with pytest.raises(LimitError, match=f"^{name} = "):
            Thresholds(**{name: value})
    with pytest.raises(msgspec.ValidationError, match=f"^{name} = .* is outside "):
        msgspec.convert({name: bound.high + 1}, Thresholds)


def test_fence_must_be_a_polygon():
    for fence in (((0.0, 0.0), (1.0, 0.0)), (*SQUARE[:2], (nan, 0.0))):
        with pytest.raises(LimitError, match="fence needs"):
            Thresholds(fence=fence)
    assert Thresholds(fence=SQUARE[:3]).fence == SQUARE[:3]


def test_ceilings_are_these_and_changing_one_is_a_decision():
    """The bounds that keep a person in the lane safe, written a second time on purpose."""
    highest = {
        "mocap_blind": 0.30, "mocap_shortest": 0.05, "mocap_longest": 0.15, "freeze_frames": 10,
        "freeze_speed": 0.3, "invalid_frames": 10, "quaternion_tolerance": 0.05, "jump_speed": 8.0,
        "jump_margin": 0.10, "jump_frames": 5, "nis_frames": 10, "nis_share": 0.5,
        "sigma_position": 0.20, "telemetry": 0.15, "cell_hold": 1.0, "fet": 95, "motor": 110,
        "lateral": 0.6, "lateral_max": 1.0, "overspeed_ratio": 1.3, "overspeed_margin": 0.3,
        "overspeed_hold": 0.1, "mismatch_speed": 1.0, "mismatch_hold": 0.4, "blocked_hold": 2.0,
        "saturated_hold": 2.0, "follow_share": 0.3, "follow_noise": 8.0, "follow_steer": 0.08,
        "follow_hold": 0.1, "follow_distance": 0.15, "stop_lag": 0.3, "stop_window": 0.5,
        "lease": 0.3,
        "suspend_step": 0.05, "out_queue": 256, "out_ticks": 3, "late": 0.025, "late_run": 3,
        "late_share": 0.02, "guardian": 0.05, "recorder_full": 1.0, "gateway_full": 1.0,
    }  # fmt: skip
    assert {name: BOUNDS[name].high for name in highest} == highest
    lowest = {"cell": 3.1, "fence_delay": 0.1, "fence_margin": 0.1, "stop_share": 0.3}
    assert {name: BOUNDS[name].low for name in lowest} == lowest
    assert set(Thresholds.__dataclass_fields__) - set(BOUNDS) == {"fence"}


# Edits of a car file: comments and order stay, invalid results are refused.
def test_edits_keep_comments_and_order():
    edits = {("mocap", "marker_rear_x"): 0.21, ("vesc", "erpm_gain"): 4300.0}
    car = load_car(default_car_path())
    text = edit_car(car, edits | {("vesc", "uuid"): "ab" * 12}).text
    old, new = car.text.splitlines(), text.splitlines()
    kept = [line for line in new if "uuid" not in line]
    changed = [(a, b) for a, b in zip(old, kept, strict=True) if a != b]
    assert [b.split("=")[0].strip() for _, b in changed] == ["erpm_gain", "marker_rear_x"]
    assert all(a.split("#")[1] == b.split("#")[1] for a, b in changed)
    assert tomllib.loads(text)["vesc"]["uuid"] == "ab" * 12


@pytest.mark.parametrize(("key", "value", "said"), [
    (("vesc", "servo_gain"), 0.0, "servo_gain must not be zero"),
    (("mocap", "marker_raer"), 0.0, "marker_raer"), (("car", "mass"), -1.0, r"car\.mass"),
])  # fmt: skip
def test_edits_with_an_invalid_result_are_refused(key, value, said):
    with pytest.raises(SteerdError, match=said):
        edit_car(load_car(default_car_path()), {key: value})


# F1TENTH's `vesc.yaml`: read, written, refused, and through `steerd config`.
YAML = """/**:
  ros__parameters:
    # erpm (electrical rpm) = speed_to_erpm_gain * speed
    speed_to_erpm_gain: 4200.5   # measured
    speed_to_erpm_offset: -12
    steering_angle_to_servo_gain: -0.9
    steering_angle_to_servo_offset: 0.48
    wheelbase: .25

vesc_driver:
  ros__parameters:
    port: "/dev/sensors/vesc"
    servo_min: 0.2
    servo_max: 0.8
    speed_max: 20000.0
    speed_min: -20000.0
"""


@pytest.mark.parametrize(("text", "said"), [
    ("port: 1", "no gain"), ("servo_min: low", "not a number"),
    ("servo_min: 0.1\nservo_min: 0.2", "twice"), ("servo_min: 0.9\nservo_max: 0.1", "servo limits"),
    ("speed_to_erpm_gain: nan", "not a number"),
])  # fmt: skip
def test_an_invalid_yaml_is_refused(text, said):
    with pytest.raises(SteerdError, match=said):
        read_vesc_yaml(text, F1TENTH)


def test_yaml_by_command_line(tmp_path, cli):
    yaml, car, back = tmp_path / "vesc.yaml", tmp_path / "car.toml", tmp_path / "back.yaml"
    yaml.write_text(YAML)
    car.write_text(cli("config", "--from-vesc-yaml", yaml).out)
    assert "# erpm per m/s" in car.read_text()
    table = tomllib.loads(car.read_text())["vesc"]
    assert all(table[key] == value for (_, key), value in
               make_car_values(read_vesc_yaml(YAML, F1TENTH)).items())  # fmt: skip
    assert run_cli(["config", "--check", str(car), "--to-vesc-yaml", str(back)]) == 0
    assert read_vesc_yaml(back.read_text(), F1TENTH) == read_vesc_yaml(YAML, F1TENTH)
