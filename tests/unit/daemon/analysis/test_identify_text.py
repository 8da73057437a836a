"""The end of what `steerd identify` says: whether to drive with it, and what to do if not."""

from dataclasses import replace
from math import nan
from pathlib import Path
from types import SimpleNamespace

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.analysis.drives import Drives
from steerd.daemon.analysis.identification import Identification, IdentifyOptions
from steerd.daemon.settings.run_options import RunOptions, encode_options
from steerd.sysid.data.excitation import Excitation
from steerd.sysid.estimation.outcome import HeldOut, Outcome, Row
from steerd.sysid.estimation.validation import Prediction
from steerd.sysid.inference.car_fit import Step

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


def test_a_result_that_helps_is_driven_with(tmp_path):
    said = describe(outcome((0.1, 0.4)), tmp_path / "car.toml")
    assert "0.5 s     100.0 mm" in said
    assert "4.0 x" in said
    assert f"steerd run --sim --fast --duration 20 --car {tmp_path / 'car.toml'}\n" in said
    assert "steerd diagnose 'drives/a b.mcap' --base " in said


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


NOTE = "the car went about as fast as asked in 2%: `--speed wheel` takes the measured speed"


@pytest.mark.parametrize(("what", "why"), [
    ({"rows": {"lf": Row(0.2, 0.16, 0.5, "m", True, False)}},
     "nothing is identifiable from these data; do not drive"),
    ({"notes": (NOTE,)}, "next        the same command with --speed wheel"),
])  # fmt: skip
def test_nobody_is_sent_driving_with_what_is_not_known_or_was_not_driven(what, why, tmp_path):
    said = describe(replace(outcome((0.1, 0.4)), **what), tmp_path / "car.toml")
    assert why in said
    assert "steerd run" not in said
