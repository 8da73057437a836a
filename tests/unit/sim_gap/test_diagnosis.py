"""The whole diagnosis on drives whose cause is known."""

from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.diagnosis import Case, GapOptions, diagnose
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.segments import with_wheel_speed
from steerd.sysid.inference.noise import noise_section
from tests.unit.sysid.inference.conftest import NOISE

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def quiet(base):
    return replace(base, sections={"noise": noise_section(NOISE)})


def test_a_healthy_car_has_no_gap(drive, base):
    told = diagnose(Case(drive("", seed=2), base, GapOptions(pairs=False)))
    assert (told.verdict, told.causes) == ("none", ())
    assert "noise was learnt" in " ".join(told.notes)


def test_unknown_effects_and_measured_speeds_beside_commanded_ones_are_refused(drive, base):
    runs, only = drive("steer_delay=0.05", runs=2, seconds=6.0), GapOptions(only=("steer_delay",))
    with pytest.raises(ValueError, match="no effect 'wings'"):
        diagnose(Case(runs, base, GapOptions(only=("wings",))))
    bare = [with_wheel_speed(run) for run in runs[1:]]
    for each, later in (([*runs, *bare], None), (runs, lambda: bare)):
        with pytest.raises(DataError, match="has no speed commands"):
            diagnose(Case(each, base, only, later))


@pytest.mark.parametrize("seed", [40, 41, 42])
@pytest.mark.parametrize(("name", "value"), [
    ("steer_delay", 0.03), ("steer_lag", 0.1), ("speed_scale", 0.93), ("marker_offset", 0.04),
])  # fmt: skip
def test_a_single_cause_is_named_and_no_second_beside_it(drive, quiet, name, value, seed):
    """Against the whole library, pairs tried."""
    told = diagnose(Case(drive(f"{name}={value}", seed=seed), quiet, horizons=False))
    (cause,) = told.causes
    assert name in {cause.effect, *cause.ambiguous_with}
    assert told.verdict in ("explained", "partial")
    assert told.something_else < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_healthy_drives_are_none_where_noise_is_known(drive, quiet, seed):
    told = diagnose(Case(drive("", seed=50 + seed), quiet, horizons=False))
    assert (told.verdict, told.causes) == ("none", ())


def _wobbling(run, size, hz):
    """The drive seen by a mocap frame that turns and shifts to and fro: no effect of a car."""
    t, pose = run.pose.t, run.pose.values.copy()
    swing = size * np.sin(2.0 * np.pi * hz * t)
    pose[:, :2] += 1.5 * np.column_stack([swing, -swing])
    pose[:, 2] += swing
    return replace(run, pose=run.pose._replace(values=pose))


@pytest.mark.parametrize("hz", [1.1, 2.3])
def test_what_is_in_no_library_gets_no_sure_name(drive, quiet, hz):
    runs = [_wobbling(run, 0.03, hz) for run in drive("", seed=60)]
    told = diagnose(Case(runs, quiet, horizons=False))
    assert told.verdict in ("unexplained", "partial")
    assert told.before.whitened > 1.5
    assert not [cause for cause in told.causes if cause.confidence > 0.8], told.causes
