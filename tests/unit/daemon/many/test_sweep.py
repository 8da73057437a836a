"""Sweeps: what a file says, draws, a drive of the drawn car, and the figures of known tables."""

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.many.sweep import plan as planning
from steerd.daemon.many.sweep.plan import Quantity, list_cases, parse_distribution
from steerd.daemon.many.sweep.run import Sweep, find_case, prepare, run_case
from steerd.daemon.many.sweep.summary import STOPS, make_share

CAR = load_car(default_car_path())


def make_plan(vary, **more):
    return planning.make_sweep_plan(CAR, {"vary": vary, **more})


# The file: lists are crossed, seeds shared, draws of the shape that was asked for.
def test_lists_are_crossed_and_every_combination_meets_every_seed():
    plan = make_plan({"path": ["line", "figure8"], "car.mass": [3.0, 3.5, 4.0]}, seeds=[4, 7])
    cases = list(list_cases(plan))
    assert plan.count == 12
    assert [(case.number, case.seed) for case in cases] == list(enumerate([4, 7] * 6))
    assert len({(*case.values.values(), case.seed) for case in cases}) == 12


def test_a_seed_draws_the_same_in_every_combination():
    drawn = {"car.mu": {"low": 0.5, "high": 1.0}}
    plan = make_plan({"speed": [1.0, 2.0], **drawn}, seeds=5)
    cases = list(list_cases(plan))
    slow, fast = cases[:5], cases[5:]
    assert [c.values["car.mu"] for c in slow] == [c.values["car.mu"] for c in fast]
    alone = list(list_cases(make_plan(drawn, seeds=9)))
    assert [c.values["car.mu"] for c in alone[:5]] == [c.values["car.mu"] for c in slow]


def test_a_share_is_one_of_the_car_files_value():
    drawn = make_plan({"car.mass": {"share": 0.1}}).vary["car.mass"]
    assert (drawn.one, drawn.other) == (CAR.car.mass, pytest.approx(0.1 * CAR.car.mass))


def test_the_digest_knows_what_the_drives_depend_on():
    given = {"car.mu": {"low": 0.5, "high": 1.0}}
    first = make_plan(given, seeds=5).digest()
    assert first == make_plan(given, seeds=5).digest()
    others = [
        make_plan(given, seeds=6), make_plan(given, seeds=5, duration=3.0),
        make_plan(given, seeds=5, path="line"), make_plan({"car.mu": [0.5, 1.0]}, seeds=5),
        make_plan({"car.mu": {"low": 0.5, "high": 1.1}}, seeds=5), make_plan({}, seeds=5),
    ]  # fmt: skip
    assert len({first, *(plan.digest() for plan in others)}) == 7


@pytest.mark.parametrize(("vary", "more", "said"), [
    ({"car.masss": [3.0]}, {}, "did you mean car.mass"), ({"weather": [1.0]}, {}, "a sweep varies"),
    ({"effect.steer_dely": [0.1]}, {}, "steer_delay"),
    ({"effect.grip_patch": [0.1]}, {}, "which of"),
    ({"effect.steer_delay.size": [0.1]}, {}, "has no 'size'"),
    ({"car.mass": [30000.0]}, {}, "car.mass = 30000"), ({"car.mass": []}, {}, "the list is empty"),
    ({"car.mass": ["heavy"]}, {}, "must be a number"),
    ({"path": {"low": 0.0, "high": 1.0}}, {}, "give a list"),
    ({"path": [3.0]}, {}, "must be a text"), ({}, {"seeds": 0}, "seeds"),
    ({}, {"seeds": [1, 1]}, "seeds"), ({}, {"seeds": [-1]}, "seeds"),
    ({}, {"seeds": True}, "seeds"), ({}, {"duration": -1.0}, "duration"),
    ({}, {"speed": "fast"}, "speed"), ({}, {"sedes": 3}, "did you mean seeds"),
    ({"car.mass": [3.0] * 2000}, {"seeds": 1000}, "2000000 drives"),
])  # fmt: skip
def test_what_is_impossible_is_refused_in_a_line(vary, more, said):
    with pytest.raises(SteerdError, match=said) as caught:
        make_plan(vary, **more)
    assert "\n" not in caught.value.what


def test_a_file_that_is_no_toml_is_refused(tmp_path):
    (tmp_path / "s.toml").write_text("[vary\n")
    for name, code in (("s.toml", ExitCode.INVALID), ("none.toml", ExitCode.UNREADABLE)):
        with pytest.raises(SteerdError) as caught:
            planning.load_sweep(tmp_path / name)
        assert caught.value.code is code


# Draws: repeatable, apart from each other, within bounds.
N = 4000


def draws(given, low=-1e9, high=1e9, usual=None, name="car.mass"):
    found = parse_distribution(Quantity(name, low, high, "kg", "", usual), given)
    return np.array([found.draw(name, seed) for seed in range(N)])


@pytest.mark.parametrize(("given", "usual", "quantiles"), [
    ({"low": 1.0, "high": 3.0}, None, (1.1, 2.0, 2.9)),
    ({"low": 1.0, "high": 100.0, "log": True}, None, (1.26, 10.0, 79.4)),
    ({"low": 1.0, "high": 3.0, "log": False}, None, (1.1, 2.0, 2.9)),
    ({"mean": 5.0, "sd": 2.0}, None, (1.71, 5.0, 8.29)),
    ({"median": 4.0, "factor": 2.0}, None, (1.28, 4.0, 12.5)),
    ({"share": 0.1}, 3.0, (2.51, 3.0, 3.49)),
])  # fmt: skip
def test_draws_have_the_shape(given, usual, quantiles):
    found = np.quantile(draws(given, usual=usual), (0.05, 0.5, 0.95))
    np.testing.assert_allclose(found, quantiles, rtol=0.06)


def test_a_draw_depends_on_seed_and_name_alone():
    one = draws({"mean": 0.0, "sd": 1.0})
    np.testing.assert_array_equal(one, draws({"mean": 0.0, "sd": 1.0}))
    other = draws({"mean": 0.0, "sd": 1.0}, name="car.mu")
    assert abs(np.corrcoef(one, other)[0, 1]) < 4.0 / np.sqrt(N)
    assert len(set(one)) == N


def test_nothing_is_drawn_outside_the_bounds_and_where_they_are_never_met_it_ends():
    values = draws({"mean": 1.0, "sd": 1.0}, low=0.5, high=2.0)
    assert 0.5 < values.min() < values.max() < 2.0, "cut, not clipped"
    assert np.std(values) > 0.3
    with pytest.raises(ValueError, match="nothing between"):
        draws({"mean": 0.0, "sd": 1e6}, low=-1e-6, high=1e-6)


@pytest.mark.parametrize(("given", "said"), [
    ({}, "low, high"), ({"low": 1.0}, "low, high"), ({"lo": 1.0, "high": 2.0}, "did you mean low"),
    ({"low": 2.0, "high": 1.0}, "not below"), ({"low": 0.0, "high": 1.0, "log": True}, "positive"),
    ({"low": -5.0, "high": 5.0}, "-1 to 10"), ({"mean": 3.0, "sd": 0.0}, "more than 0"),
    ({"mean": "x", "sd": 1.0}, "must be a number"), ({"mean": True, "sd": 1.0}, "must be a number"),
    ({"mean": float("nan"), "sd": 1.0}, "must be a number"),
    ({"mean": 30.0, "sd": 1.0}, "-1 to 10"), ({"share": 0.1}, "give mean and sd"),
])  # fmt: skip
def test_what_is_no_distribution_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        parse_distribution(Quantity("car.mass", -1.0, 10.0, "kg", ""), given)


# One drive: the drawn car is the one that drives, and its judges agree with it.
def test_what_is_varied_reaches_the_simulated_hardware():
    vary = {
        "car.mass": [4.5], "effect.steer_delay": [0.03], "effect.grip_patch.x": [2.0],
        "effect.grip_patch.drop": [0.4], "mocap.position_noise": [0.002], "mocap.latency": [0.02],
        "mocap.jitter": [0.001], "vesc.erpm_noise": [9.0], "vesc.reply_delay": [0.001],
        "speed": [1.7],
    }  # fmt: skip
    plan = make_plan(vary, seeds=1, duration=0.6, path="line")
    run_plan, config = prepare(plan, find_case(plan, 0))
    model = config.model
    assert model.car.mass == 4.5
    assert run_plan.settings.file.car.mass == plan.car.car.mass, "the design knows nothing of it"
    found = {e.name: values for e, values in zip(model.effects, model.values, strict=True)}
    assert found["steer_delay"] == (0.03,)
    assert found["grip_patch"] == (2.0, 0.0, 0.5, 0.4, 0.0)
    mocap, vesc = config.mocap, config.vesc
    assert (mocap.position_noise, mocap.jitter_ns) == (0.002, 1_000_000)
    assert mocap.camera_ns + mocap.software_ns == 20_000_000
    assert (vesc.erpm_noise, vesc.reply_delay_ns) == (9.0, 1_000_000)
    assert run_plan.options.speed == 1.7


def test_a_lane_that_cannot_be_designed_is_a_row():
    plan = make_plan({"path": ["circle:radius=0.4"]}, seeds=1)
    row = run_case(plan, find_case(plan, 0))
    assert row["outcome"] == "refused"
    assert "radius" in row["reason"]


@pytest.mark.slow
def test_a_drive_is_judged_and_a_slower_servo_bears_less_delay():
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
def test_a_car_that_its_watchdogs_stop_says_which():
    plan = make_plan({"car.steer_gain": [0.3]}, seeds=1, duration=8.0, path="circle:radius=2")
    row = run_case(plan, find_case(plan, 0))
    assert row["outcome"] == "stopped"
    assert row["watchdog"].startswith("W")
    assert row["reason"].startswith(row["watchdog"])


# The figures of screen and page, on tables whose answers are known.
DRIVES = 200


@pytest.fixture(scope="module")
def found():
    """Errors that grow with the delay, stops on one path, a mass that moves nothing."""
    vary = {"path": ["line", "figure8"], "car.mass": {"share": 0.1}}
    vary["effect.steer_delay"] = {"low": 0.0, "high": 0.04}
    plan, rng = make_plan(vary, seeds=DRIVES // 2), np.random.default_rng(3)
    rows = []
    for case in list_cases(plan):
        delay, margin = case.values["effect.steer_delay"], rng.random()
        row = {"outcome": "driven", "e1_rms": 1e-3 + delay**2}
        if delay > 0.03 and case.values["path"] == "figure8":
            row = {"outcome": "stopped", "watchdog": "W17"}
        same = {"drive": case.number, "seconds": 5.0, "damping": 0.5, "steer_margin": margin}
        rows.append(case.values | same | row)
    return Sweep(tuple(rows), 0, 0.0, plan)


def test_what_moves_what_is_found_and_the_rest_is_not_shown(found):
    moves = {(s.quantity, s.measure): s for s in found.sensitivities}
    moved = moves["effect.steer_delay", "e1_rms"]
    assert moved.value == pytest.approx(1.0)
    assert moved.shown
    assert moved.start == pytest.approx(1.02e-3, abs=0.02e-3), "over the lowest fifth of delays"
    assert moved.end == pytest.approx(2.15e-3, abs=0.2e-3)
    assert moves["path", STOPS].shown
    assert moves["effect.steer_delay", STOPS].value > 0.3
    assert abs(moves["car.mass", "steer_margin"].value) < 0.2
    assert ("car.mass", "damping") not in moves, "it never varied"


def test_stops_are_counted_with_wilsons_interval(found):
    stops = sum(row["outcome"] == "stopped" for row in found.rows)
    (share,) = (s for s in found.outcomes if s.name == "stopped")
    assert (share.count, share.of) == (stops, DRIVES)
    assert [(s.name, s.count) for s in found.watchdogs] == [("W17", stops)]
    half = make_share("x", 5, 10)
    assert (half.low, half.high) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def test_the_worst_drive_is_named(found):
    spreads, rows = {s.name: s for s in found.spreads}, found.rows
    error, margin = spreads["e1_rms"], spreads["steer_margin"]
    assert rows[error.worst_drive]["e1_rms"] == error.worst
    assert error.worst == max(row.get("e1_rms", 0.0) for row in rows)
    assert margin.worst == min(row["steer_margin"] for row in rows), "small margins are bad"
    assert margin.low < margin.middle < margin.high
