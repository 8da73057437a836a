"""One drive of a sweep: the drawn car is the one that drives, and its judges agree with it."""

import pytest

from steerd.daemon.many.sweep.run import find_case, prepare, run_case

SHORT = {"seeds": 1, "duration": 0.6, "path": "line"}


def test_what_is_varied_reaches_the_simulated_hardware(make_plan):
    vary = {
        "car.mass": [4.5],
        "effect.steer_delay": [0.03],
        "effect.grip_patch.x": [2.0],
        "effect.grip_patch.drop": [0.4],
        "mocap.position_noise": [0.002],
        "mocap.latency": [0.02],
        "mocap.jitter": [0.001],
        "vesc.erpm_noise": [9.0],
        "vesc.reply_delay": [0.001],
        "speed": [1.7],
    }
    plan = make_plan(vary, **SHORT)
    run_plan, config = prepare(plan, find_case(plan, 0))
    model = config.model
    assert model.car.mass == 4.5
    assert run_plan.settings.file.car.mass == plan.car.car.mass, "the design knows nothing of it"
    assert [effect.name for effect in model.effects] == ["steer_delay", "grip_patch"]
    assert model.values[0] == (0.03,)
    patch = dict(zip((p.name for p in model.effects[1].parameters), model.values[1], strict=True))
    assert (patch["x"], patch["drop"]) == (2.0, 0.4)
    assert config.mocap.position_noise == 0.002
    assert config.mocap.camera_ns + config.mocap.software_ns == 20_000_000
    assert config.mocap.jitter_ns == 1_000_000
    assert (config.vesc.erpm_noise, config.vesc.reply_delay_ns) == (9.0, 1_000_000)
    assert run_plan.options.speed == 1.7


def test_a_lane_that_cannot_be_designed_is_a_row(make_plan):
    plan = make_plan({"path": ["circle:radius=0.4"]}, seeds=1)
    row = run_case(plan, find_case(plan, 0))
    assert row["outcome"] == "refused"
    assert "radius" in row["reason"]


@pytest.mark.slow
def test_a_drive_is_judged_and_a_slower_servo_bears_less_delay(make_plan):
    plan = make_plan({"effect.steer_delay": [0.0, 0.08]}, seeds=1, duration=5.0, speed=1.5)
    prompt, late = (run_case(plan, find_case(plan, n)) for n in (0, 1))
    for row in (prompt, late):
        assert row["outcome"] == "driven"
        assert 0.0 < row["true_e1_rms"] <= row["true_e1_max"] < 0.2
        assert row["e1_rms"] <= row["e1_p95"] <= row["e1_max"]
        assert row["lane_margin"] == pytest.approx(0.30 - row["e1_max"])
        assert 0.0 < row["steer_margin"] < 1.0
        assert row["metres"] > 5.0
    assert late["delay_margin"] <= prompt["delay_margin"] - 0.05
    assert late["true_e1_max"] > prompt["true_e1_max"]


@pytest.mark.slow
def test_a_car_that_its_watchdogs_stop_says_which(make_plan):
    plan = make_plan({"car.steer_gain": [0.3]}, seeds=1, duration=8.0, path="circle:radius=2")
    row = run_case(plan, find_case(plan, 0))
    assert row["outcome"] == "stopped"
    assert row["watchdog"].startswith("W")
    assert row["reason"].startswith(row["watchdog"])
