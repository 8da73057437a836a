"""What drives without a gap tell about the base car."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.car_model.effects import EFFECTS
from steerd.car_model.params import DEFAULT_CAR
from steerd.sim_gap.diagnosis import Case, GapOptions, diagnose
from steerd.sysid.inference.car_fit import Stated
from steerd.sysid.inference.car_posterior import refine

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def refined(drive, base):
    """A car that slips and bends its linkage, known only from a base that does neither."""
    return refine(base, drive("wheel_slip=0.006,steer_nonlinearity=-0.6", runs=6, seed=5))


def test_what_is_learnt_lies_within_its_errors(refined):
    """Slip and a late pose, a bent linkage and its gain look alike: their errors must say so."""
    truth = {**DEFAULT_CAR._asdict(), "wheel_slip.slip": 0.006, "steer_nonlinearity.cubic": -0.6}
    found = refined.numbers
    told = found.keys() & truth.keys() & refined.sd.keys()
    away = {n: (found[n] - truth[n]) / refined.sd[n] for n in told}
    assert {"steer_gain", "pose_delay", "lf", "c_sf"} <= set(away)
    assert max(map(abs, away.values())) < 3.5
    assert np.sqrt(np.mean(np.square(list(away.values())))) < 1.6


def test_a_manner_of_the_car_is_no_gap(refined, drive):
    again = drive("wheel_slip=0.006,steer_nonlinearity=-0.6", runs=4, seed=9)
    assert diagnose(Case(again, refined, GapOptions(pairs=False))).verdict == "none"


def test_a_stated_wheelbase_and_what_is_held_stay(drive, base, refined):
    runs = drive("wheel_slip=0.006,steer_nonlinearity=-0.6", runs=6, seed=5)
    stated = Stated(wheelbase=True, held=("steer_gain", "tyre_saturation", "c_sr"))
    found = refine(base, runs, stated)
    length = base.car.lf + base.car.lr
    assert found.car.lf + found.car.lr == pytest.approx(length, abs=3e-4)
    assert (found.car.steer_gain, found.car.c_sr) == (base.car.steer_gain, base.car.c_sr)
    assert "tyre_saturation" not in {e.name for e in found.effects}
    assert found.sd["c_sr"] == base.sd["c_sr"]
    assert found.sd["lf"] < 0.8 * refined.sd["lf"], "a known distance helps to find the rest"


@pytest.fixture(scope="module")
def learnt(drive, base):
    """Of drives whose wheel speed is far quieter than it is believed to be."""
    return refine(base, drive("", runs=4, seconds=6.0, seed=3, wheel_sd=0.001))


def test_a_base_takes_no_limit_for_its_own_that_its_drives_went_beyond(learnt, drive):
    """However wide its standard error: nothing meets a limit until the car accelerates so hard."""
    known, gains = learnt.sections["knowledge"], []
    assert 3.0 < known["least"]["accel_max"] < DEFAULT_CAR.accel_max
    later = drive("accel_limit=2.6", runs=4, seconds=6.0, seed=4, wheel_sd=0.001)
    for least in (known["least"], {}):
        table = {"knowledge": {**known, "least": least}}
        car = replace(learnt, sections={**learnt.sections, **table})
        told = diagnose(Case(later, car, GapOptions(pairs=False), horizons=False))
        gains.append({name: gain for name, _, gain in told.candidates}["accel_limit"])
    assert gains[0] > 10.0 * gains[1]


def test_a_base_that_does_not_hold_its_own_drives_names_only_what_is_larger(drive, base):
    """Two drives with a brake that drags and two without: no one car makes them all."""
    dragging = drive("rolling_drag=2.5,steer_bias=0.03", runs=2, seed=4)
    poor = refine(base, [*drive("", runs=2, seed=3), *dragging])
    for hidden, causes in (("", []), ("steer_gain=0.6", ["steer_gain"])):
        later = drive(hidden, seconds=6.0, seed=6)
        told = diagnose(Case(later, poor, GapOptions(pairs=False), horizons=False))
        assert [cause.effect for cause in told.causes] == causes
        assert causes or told.verdict == "unjudged"
        assert any("does not hold the drives" in note for note in told.notes)


def test_where_the_body_is_and_the_centre_of_gravity_are_known_less_well_together(drive, base):
    found = refine(base, drive("marker_offset=0.03", runs=4, seconds=6.0, seed=3))
    for name in ("lf", "lr"):
        away = getattr(found.car, name) - getattr(DEFAULT_CAR, name)
        assert abs(away) < 2.0 * found.sd[name]
        assert found.sd[name] > 0.01


def _stamped_late(runs):
    late = [np.column_stack([r.commands[:, 0], np.roll(r.commands[:, 1], 1)]) for r in runs]
    return [replace(r, commands=c) for r, c in zip(runs, late, strict=True)]


def test_what_healthy_drives_show_is_kept_of_every_effect(learnt, drive, base):
    """Also of a slippery place, which has no derivative at its null and is in no car file."""
    spot = refine(base, drive("grip_patch:x=3,radius=1,drop=0.5", runs=4, seconds=6.0, seed=3))
    kept = [found.sections["knowledge"]["controls"] for found in (learnt, spot)]
    assert set(kept[0]) == set(kept[1]) == set(EFFECTS)
    gains = [controls["grip_patch"][2] for controls in kept]
    assert 0.0 < gains[0] < 0.5 * gains[1]


def test_a_later_dead_time_is_counted_from_one_that_would_be_below_zero(drive, base):
    """The log stamps every speed command a step late: no dead time is short enough."""
    found = refine(base, _stamped_late(drive("", runs=4, seconds=6.0, seed=3)))
    off = found.sections["knowledge"]["controls"]["drive_delay"][0][0]
    assert found.car.drive_delay < 1e-3
    assert off < -0.0025
    later = _stamped_late(drive("drive_delay=0.06", runs=4, seconds=6.0, seed=4))
    told = diagnose(Case(later, found, GapOptions(pairs=False), horizons=False))
    (taken,), (value, sd, _) = told.values["drive_delay"], told.causes[0].parameters["delay"]
    assert value == pytest.approx(0.06, abs=2.0 * sd)
    assert taken < 0.06 - 2.0 * sd
    assert value - taken == pytest.approx(-off)
    assert any("the base car is off by" in note for note in told.notes)
