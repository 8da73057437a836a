"""The whole diagnosis on drives whose cause is known."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from steerd.sim_gap.diagnosis import Options, diagnose
from steerd.sim_gap.report.to_json import to_json
from steerd.sysid.inference.noise import Noise

pytestmark = pytest.mark.slow

NOISE = Noise((7e-4, 2e-3, 0.02, 0.05), (0.4, 0.4, 2.5), 1e-4)
"""What `tests/unit/conftest.py` adds to its drives."""


@pytest.fixture(scope="module")
def late_steering(drive, base):
    written = []
    runs = drive("steer_delay=0.03", runs=6, seed=1)
    told = diagnose(runs[:4], base, Options(held_out=runs[4:], written=written.append, pairs=False))
    return told, written


def test_names_the_cause_with_its_size(late_steering):
    told, _ = late_steering
    assert told.verdict == "explained"
    cause = told.causes[0]
    value, sd, unit = cause.parameters["delay"]
    assert (cause.effect, cause.stage, cause.family) == ("steer_delay", "command", "timing")
    assert abs(value - 0.03) < max(4 * sd, 0.003)
    assert unit == "s"
    assert cause.confidence > 0.8


def test_the_error_lies_in_the_steering(late_steering):
    told, _ = late_steering
    assert told.where.equation[0].name == "steer"
    assert told.where.stage == "actuator"
    assert abs(sum(s.share for s in told.where.equation) - 1.0) < 1e-6


def test_prediction_is_written_before_and_holds_after(late_steering):
    told, written = late_steering
    s = told.shrinkage
    assert written == [s.text]
    assert s.digest == hashlib.sha256(written[0].encode()).hexdigest()
    assert s.measured is not None
    assert s.measured > 0.5
    assert abs(s.measured - s.predicted) < 0.3


def test_json_has_the_shape_of_the_schema(late_steering):
    told, _ = late_steering
    data = json.loads(json.dumps(to_json(told), allow_nan=False))
    assert data["schema"] == "steerd.gap/1"
    assert set(data) == {
        "schema", "verdict", "gap", "where", "causes", "candidates", "something_else",
        "next_manoeuvre", "residual",
    }  # fmt: skip
    assert 0.0 <= data["something_else"] <= 1.0
    assert set(data["where"]) == {
        "stage", "equation", "channels", "windows", "regimes", "sentence"
    }  # fmt: skip
    assert set(data["causes"][0]) == {
        "effect", "stage", "family", "parameters", "confidence", "shrink", "ambiguous_with"
    }  # fmt: skip
    assert set(data["causes"][0]["shrink"]) == {"predicted", "measured", "low", "high"}
    assert data["gap"]["before"]["whitened"] > data["gap"]["after"]["whitened"]


def test_a_healthy_car_has_no_gap(drive, base):
    told = diagnose(drive("", seed=2), base, Options(pairs=False))
    assert told.verdict == "none"
    assert told.causes == ()
    assert "noise was learnt" in " ".join(told.notes)


def test_unknown_effects_are_refused(drive, base):
    with pytest.raises(ValueError, match="no effect 'wings'"):
        diagnose(drive("", runs=1, seconds=4.0), base, Options(only=("wings",)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "hidden", ["steer_delay=0.03", "steer_lag=0.1", "speed_scale=0.93", "marker_offset=0.04"]
)
def test_a_single_cause_is_named_and_no_second_beside_it(drive, base, hidden, seed):
    """Against the whole library, pairs tried."""
    told = diagnose(drive(hidden, seed=40 + seed), base, Options(noise=NOISE, horizons=False))
    name = hidden.partition("=")[0]
    (cause,) = told.causes
    assert name in {cause.effect, *cause.ambiguous_with}
    assert told.verdict in ("explained", "partial")
    assert told.something_else < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_healthy_drives_are_none_where_noise_is_known(drive, base, seed):
    told = diagnose(drive("", seed=50 + seed), base, Options(noise=NOISE, horizons=False))
    assert (told.verdict, told.causes) == ("none", ())


def _wobbling(run, size, hz):
    """The drive seen by a mocap frame that turns and shifts to and fro: no effect of a car."""
    t, pose = run.pose.t, run.pose.values.copy()
    swing = size * np.sin(2.0 * np.pi * hz * t)
    pose[:, :2] += 1.5 * np.column_stack([swing, -swing])
    pose[:, 2] += swing
    return replace(run, pose=run.pose._replace(values=pose))


@pytest.mark.parametrize("hz", [1.1, 2.3])
def test_what_is_in_no_library_gets_no_sure_name(drive, base, hz):
    runs = [_wobbling(run, 0.03, hz) for run in drive("", seed=60)]
    told = diagnose(runs, base, Options(noise=NOISE, horizons=False))
    assert told.verdict in ("unexplained", "partial")
    assert told.before.whitened > 1.5
    assert not [cause for cause in told.causes if cause.confidence > 0.8], told.causes
