"""What comes of an identification: drives that are read, a car file, and what is said of both."""

import tomllib
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from steerd.car_model.car_file import Learned, default_car_path, load_car, parse_car
from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis import drives as module
from steerd.daemon.analysis import options
from steerd.daemon.analysis.car_output import find_wiring, learn_known, make_car
from steerd.daemon.analysis.drives import Drives, is_same, load_drives, split_drives
from steerd.daemon.analysis.identification import Identification, IdentifyOptions
from steerd.daemon.analysis.options import Watch, read_car
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.sim_gap.diagnosis import Case
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import open_session
from steerd.sysid.data.dataset import Run, Signal, make_run
from steerd.sysid.data.excitation import Excitation
from steerd.sysid.data.segments import SPEED_MIN, moving_segments
from steerd.sysid.estimation.outcome import HeldOut, Outcome, Row
from steerd.sysid.estimation.validation import Prediction
from steerd.sysid.inference.car_fit import Step
from steerd.sysid.inference.noise import Noise, noise_section


@pytest.fixture
def minutes(monkeypatch):
    """Sessions that are as many minutes long as their names say."""

    def load(path, speed, watch):
        t = 0.1 * np.arange(600 * int(path.stem) + 1)
        turned = t / 5.0
        pose = np.column_stack([5.0 * np.sin(turned), -5.0 * np.cos(turned), turned])
        steer, speed = Signal(t, 0.1 * np.sin(t)), Signal(t, np.ones_like(t))
        return None, make_run(path.name, steer, speed, Signal(t, pose))

    monkeypatch.setattr(module, "load_drive", load)

    def opened(*names):
        said, read = [], []
        paths = [Path(f"{name}.mcap") for name in names]
        found = load_drives(paths, "command", Watch(said.extend), read.append)
        assert read == [(n + 1) / len(paths) for n in range(len(paths))]
        return found.runs, said

    return opened


def test_short_drives_are_taken_whole_and_of_long_ones_pieces_which_is_said(minutes):
    found, said = minutes(2, 3)
    assert [run.driven for run in found] == pytest.approx([120.0, 180.0], abs=0.03)
    assert said == []
    found, said = minutes(90, 1)
    assert sum(run.driven for run in found) == pytest.approx(660.0, rel=0.05)
    assert said == ["of 1.5 h 11 min are used, in pieces of 30 s, evenly from all sessions"]
    assert {run.name for run in found} == {"90.mcap", "1.mcap"}


def test_many_sessions_share_what_is_looked_at(minutes):
    found, said = minutes(*range(2, 82))
    assert sum(run.driven for run in found) == pytest.approx(1200.0, rel=0.03)
    assert sum(run.driven for run in found) <= 1200.0
    numbers = [int(run.name.removesuffix(".mcap")) for run in found]
    assert (numbers[0], numbers[-1], set(np.diff(numbers))) == (2, 81, {2, 3})
    assert said[0].startswith("of 55.")


def test_sessions_are_held_out_whole_though_they_are_in_pieces(minutes):
    found, _ = minutes(20, 21, 22, 23, 24)
    case = split_drives(Case(found, read_car(None)), options.HeldOut(), "command", Watch())
    assert case.held_out_of == "every 4th session: 23.mcap"
    assert {run.name for run in case.later()} == {"23.mcap"}
    assert {run.name for run in case.runs} == {f"{n}.mcap" for n in (20, 21, 22, 24)}


# Car files: digits, comments, wiring and noise.
BASE = load_car(default_car_path())
FOUND = Learned(0.063010764350838, 0.000155127898, "steerd identify (ours): mixed.mcap")


def line(car, key):
    return next(each for each in car.text.splitlines() if each.startswith(f"{key} = "))


@pytest.mark.parametrize(("value", "sd", "shown"), [
    (15.2428916, 0.193184, 15.243), (9.668802290607, 6.69e-05, 9.6688023), (123.45678, 25.0, 123.5),
    (4.11234567, None, 4.11235), (4.11234567, 0.0, 4.11235), (4.11234567, inf, 4.11235),
])  # fmt: skip
def test_a_value_has_the_digits_that_its_error_leaves(value, sd, shown):
    """Rounding costs a two-hundredth of the error at most."""
    car = make_car(BASE, {"c_x": Learned(value, sd, "")}, Path("x.toml"))
    assert car.car.c_x == shown
    assert not sd or not sd < inf or abs(shown - value) <= sd / 200.0 + 1e-12


def test_comments_belong_to_the_values_that_stand_there():
    car = make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml"))
    assert "engineering estimate" in line(BASE, "steer_lag")
    said = "# s ± 0.00016, first-order lag of the servo, identify (ours)"
    assert line(car, "steer_lag").endswith(said)
    assert line(car, "speed_lag") == line(BASE, "speed_lag"), "what was not found stays as it was"
    old, new = tomllib.loads(BASE.text), tomllib.loads(car.text)
    assert {**old, "car": None} == {**new, "car": None}
    again = make_car(car, {"steer_lag": Learned(0.05, None, "given with --fix")}, car.path)
    assert line(again, "steer_lag").endswith("# s, first-order lag of the servo, given with --fix")


def test_an_effect_gets_its_comment_under_its_alias_too():
    text = BASE.text + "\n[effects.steer_delay]\ndelay = 0.02  # guessed\n"
    base = parse_car(text, Path("own.toml"))
    car = make_car(base, {"steer_delay.delay": Learned(0.05012345, 0.001, "x")}, base.path)
    assert "guessed" not in car.text
    assert car.values == (*BASE.values, (0.05012,))
    assert "± 0.001" in line(car, "delay")


def test_the_published_name_is_not_handed_on_and_a_name_of_ones_own_is():
    assert make_car(BASE, {"steer_lag": FOUND}, Path("blue.toml")).name == "blue"
    mine = parse_car(BASE.text.replace(BASE.name, "The blue one"), Path("mine.toml"))
    assert make_car(mine, {"steer_lag": FOUND}, Path("blue.toml")).name == "The blue one"


# A car file that began as F1TENTH's gets the wiring of the drives that it was learnt from.
MINE = Path("mine.toml")
OWN = BASE.text.replace("erpm_gain = 4614.0", "erpm_gain = -7300.0").replace('up = "y"', 'up = "z"')


def write_drives(folder, *car_texts, **about):
    """Drives with these car files, or with what an import was given about the motor."""
    for number, text in enumerate(car_texts):
        files, metadata = (
            {"car.toml": text.encode()} if text else {},
            {"steerd.session": {}, **about},
        )
        writer = SessionWriter(folder / f"{number}.mcap", {}, metadata, files)
        yield open_session(writer.finish({"reason": "end"}))


def test_the_drives_own_motor_and_mocap_or_what_an_import_was_given_stand_in_the_file(tmp_path):
    wiring = find_wiring(BASE, [*write_drives(tmp_path, OWN, OWN)])
    made = tomllib.loads(make_car(BASE, {}, MINE, wiring).text)
    assert made["vesc"]["erpm_gain"] == -7300.0
    assert made["mocap"]["up"] == "z"
    assert made["car"] == tomllib.loads(BASE.text)["car"] | {"name": "mine"}
    (tmp_path / "imported").mkdir()
    given = {"steerd.scaling": {"erpm_gain": "-7350.0", "erpm_offset": "0.0"}}
    imported = [*write_drives(tmp_path / "imported", None, **given)]
    assert find_wiring(BASE, imported) == {("vesc", "erpm_gain"): -7350.0}


@pytest.mark.parametrize(("base", "texts"), [
    (BASE, [BASE.text]), (parse_car(BASE.text, MINE), [OWN]), (BASE, [OWN, BASE.text]),
    (BASE, [None]),
], ids=["default", "named", "differ", "none"])  # fmt: skip
def test_nothing_changes_without_a_wiring_that_all_drives_share(tmp_path, base, texts):
    assert find_wiring(base, [*write_drives(tmp_path, *texts)]) == {}


def test_a_wiring_that_no_file_may_hold_loses_no_result(tmp_path):
    wrong = OWN.replace("\n[vesc]", "\n[vesc]\nof_another_version = 1.0")
    wiring = find_wiring(BASE, [*write_drives(tmp_path, wrong)])
    assert wiring
    assert make_car(BASE, {}, MINE, wiring).text == make_car(BASE, {}, MINE).text


# Noise is learnt where the car moves, as diagnose judges.
NOISE = Noise((1e-3, 2e-3, 0.02, 0.03), (0.4, 0.3, 2.0))


def _straight(speed) -> Run:
    """20 s along x at speeds (2000,) [m/s]."""
    t = np.arange(2000) * 0.01
    pose = np.column_stack([np.cumsum(speed) * 0.01, np.zeros((2000, 2))])
    return make_run("straight", Signal(t, np.zeros(2000)), Signal(t, speed), Signal(t, pose))


def test_noise_is_learnt_where_the_car_moves(monkeypatch):
    seen = []
    monkeypatch.setattr(
        "steerd.daemon.analysis.car_output.learn_sections",
        lambda car, runs: (seen.extend(runs), {"noise": noise_section(NOISE)})[1],
    )
    assert learn_known(BASE, (_straight(np.full(2000, 0.5 * SPEED_MIN)),)) == {}
    run = _straight(np.repeat([0.0, 1.5], 1000))
    assert learn_known(BASE, (run,)) == {"noise": noise_section(NOISE)}
    assert [r.duration for r in seen] == [r.duration for r in moving_segments([run])]
    assert all(np.all(r.commands[:, 1] > SPEED_MIN) for r in seen)
    assert sum(r.duration for r in seen) < 10.0


# The end of what is said: whether to drive with it, and what to do if not.
DRIVEN = Excitation(60.0, 100.0, 1.0, 2.0, 0.1, 1.0, 0.4, 0.4, 3.0, ())
SIMULATED = {"steerd.session": {"options": encode_options(RunOptions("", simulated=True))}}


def describe(found, written=None, *, wheelbase=None, metadata=SIMULATED) -> str:
    return identified(found, wheelbase, metadata).describe(written)


def identified(found, wheelbase=None, metadata=SIMULATED) -> Identification:
    info = SimpleNamespace(path=Path("drives/a b.mcap"), metadata=metadata)
    drives = Drives((SimpleNamespace(info=lambda: info),), ())
    return Identification(IdentifyOptions(wheelbase=wheelbase), None, drives, found)


def outcome(*positions: tuple[float, float], medians: tuple[float, float] = (1.0, 0.5)) -> Outcome:
    """With position errors after and before at 0.5 s and so on [m]."""
    held_out = tuple(
        HeldOut(*(Prediction(0.5 * k, *errors, 0.01) for errors in zip(rms, medians, strict=True)))
        for k, rms in enumerate(positions, 1)
    )
    rows = {"lf": Row(0.2, 0.16, 0.01, "m", True, True)}
    return Outcome(
        "ours", ("a.mcap",), "b.mcap", DEFAULT_CAR, DEFAULT_CAR, rows, held_out, DRIVEN, ([], [])
    )


@pytest.mark.parametrize(("positions", "better"), [
    (((0.2, 0.1), (0.3, 0.9)), True),  # the longest prediction decides
    (((0.1, 0.2), (1.01, 1.0)), True),  # 2 % are noise
    (((0.1, 0.2), (1.03, 1.0)), False),
    (((0.1, 0.2), (nan, nan)), True),  # no held-out drive is so long: the one before
    (((nan, nan),), False),
])  # fmt: skip
def test_the_longest_known_prediction_decides(positions, better):
    assert identified(outcome(*positions)).improved is better


def test_one_spin_does_not_make_a_car_worse_than_its_start():
    spun = outcome((0.6, 0.5), medians=(0.005, 0.3))
    assert identified(spun).improved
    assert "median 5.0 mm (start 300.0 mm)" in describe(spun)
    assert not identified(outcome((0.6, 0.5), medians=(0.31, 0.3))).improved


def test_what_is_not_identified_is_one_sentence_with_the_drive_that_helps_most():
    hints = {"lf": "slow bends", "lr": "bends", "mass": "", "c_sf": "bends"}
    rows = {n: Row(0.2, 0.16, 0.1, "m", True, False, hint) for n, hint in hints.items()}
    rows["mu"] = Row(1.0, 1.001, 0.01, "1", True, True)
    said = describe(replace(outcome((0.1, 0.4)), rows=rows)).split("\n\n")[1]
    assert said.splitlines() == [
        "            mu                    1.000 ± 0.010         unchanged",
        "open        these drives do not identify lf, lr, mass, c_sf; what would help",
        "            most is bends.",
    ]


def test_a_result_that_does_not_help_is_not_and_the_axles_may_be_why():
    worse = outcome((0.4, 0.1))
    said = describe(worse)
    assert "keep the old car file" in said
    assert "--wheelbase" in said
    assert "--car" not in said
    assert "--wheelbase" not in describe(worse, wheelbase=0.33)


def test_drives_that_are_too_gentle_are_not_blamed_on_the_axles():
    row = Row(0.2, 0.16, 0.1, "m", True, False, "bends")
    fitted = SimpleNamespace(
        misfit={"position": 1.1}, horizon=5.4, selected=(Step("steer_backlash", 97.4),),
        combinations=(),
    )  # fmt: skip
    found = replace(outcome((0.4, 0.1)), rows={"lf": row}, fit=fitted)
    said = describe(found)
    assert "keep the old car file" in said
    assert "too gentle" in said
    assert "`steerd collect --plan mixed --sim --fast`" in said
    assert "`steerd collect --help`" in describe(found, metadata={})
    assert "--wheelbase" not in said
    lines = said.splitlines()
    assert "effect      steer_backlash: selected, these drives show it (gains 97 nats)" in lines
    assert any(line.startswith("method      ours (windows of 5 s)") for line in lines)


@pytest.mark.parametrize(("what", "why"), [
    ({"rows": {"lf": Row(0.2, 0.16, 0.5, "m", True, False)}},
     "nothing is identifiable from these data; do not drive"),
    ({"notes": ("2% as fast as asked: `--speed wheel` takes the measured speed instead",)},
     "next        the same command with --speed wheel"),
])  # fmt: skip
def test_nobody_is_sent_driving_with_what_is_not_known_or_was_not_driven(what, why, tmp_path):
    said = describe(replace(outcome((0.1, 0.4)), **what), tmp_path / "car.toml")
    assert why in said
    assert "steerd run" not in said


# One drive under two names: recognised by its content, for a copy is no second drive.
@pytest.mark.parametrize(("one", "other", "same"), [
    ("a", "a", True), ("a", "copy", True), ("a", "link", True), ("link", "copy", True),
    ("a", "b", False), ("a", "none", False), ("none", "none", True),
])  # fmt: skip
def test_what_is_the_same_drive(one, other, same, tmp_path):
    for name, content in (("a", b"first"), ("b", b"other"), ("copy", b"first")):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert is_same(tmp_path / one, tmp_path / other) is same
