"""What drives without a gap teach the base car."""

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.sim_gap.diagnosis import Options, diagnose
from steerd.sim_gap.healthy_drives import refine

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def refined(drive, base):
    """A car that slips and bends its linkage, known only from a base that does neither."""
    return refine(base, drive("wheel_slip=0.006,steer_nonlinearity=-0.6", runs=6, seed=5))


def test_slip_is_the_cars_own_and_no_late_pose(refined):
    own = {e.name: v for e, v in zip(refined.effects, refined.values, strict=True)}
    assert own["wheel_slip"][0] == pytest.approx(0.006, abs=0.0025)
    assert refined.car.pose_delay == pytest.approx(DEFAULT_CAR.pose_delay, abs=0.002)
    assert refined.car.steer_delay == pytest.approx(DEFAULT_CAR.steer_delay, abs=0.003)


def test_the_linkages_bend_is_the_cars_own(refined):
    own = {e.name: v for e, v in zip(refined.effects, refined.values, strict=True)}
    assert own["steer_nonlinearity"][0] == pytest.approx(-0.6, abs=0.25)
    assert refined.car.steer_gain == pytest.approx(DEFAULT_CAR.steer_gain, abs=0.02)


def test_a_manner_of_the_car_is_no_gap(refined, drive):
    again = drive("wheel_slip=0.006,steer_nonlinearity=-0.6", runs=4, seed=9)
    assert diagnose(again, refined, Options(pairs=False)).verdict == "none"


@pytest.fixture(scope="module")
def quiet(drive):
    """Drives whose wheel speed is far quieter than it is believed to be."""
    return drive("", runs=4, seconds=6.0, seed=3, wheel_sd=0.001)


@pytest.fixture(scope="module")
def learnt(base, quiet):
    return refine(base, quiet)


def test_drives_have_no_gap_to_themselves(learnt, quiet):
    told = diagnose(quiet, learnt, Options(pairs=False, horizons=False))
    assert told.noise_known
    assert told.verdict == "none"


def test_other_drives_of_the_same_car_have_no_gap(learnt, drive):
    again = drive("", runs=4, seconds=6.0, seed=4, wheel_sd=0.001)
    told = diagnose(again, learnt, Options(pairs=False, horizons=False))
    assert told.noise_known
    assert told.verdict == "none"
