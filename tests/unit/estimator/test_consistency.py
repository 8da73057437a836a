"""Is the filter as accurate as it says? Shown over seeded runs, with two-sided 99 % bounds.

Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, 5.4: summed
over independent runs, normalised errors squared (NEES, 7 states) and normalised innovations squared
(NIS) are chi-square. The last tests turn the filter's beliefs wrong and must see it.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from steerd.car_model.chassis import Chassis
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.planar import PLANAR
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command, State
from steerd.estimator.config import FilterConfig
from steerd.estimator.sensors import Kind
from steerd.estimator.state_filter import make_state_filter, predict_to

pytestmark = pytest.mark.slow
RUNS = 40
SECONDS = 2.6
CONFIG = FilterConfig(history_s=2.0)
SAMPLE_NS = 250_000_000
"""Errors this far apart are nearly independent (the slowest state fades in 0.1 s)."""
SETTLED_NS = 10**12 + 500_000_000
WIDTHS = {Kind.POSE: 3, Kind.WHEEL_SPEED: 1, Kind.GYRO: 1}


class Record(NamedTuple):
    scaled: np.ndarray  # (instants, 7) errors over their standard deviations
    nees: np.ndarray  # (instants,)
    nis: dict[Kind, list[float]]
    refused: int


def record(drive: Any, run_filter: Any, config: FilterConfig, chassis: Chassis = SINGLE_TRACK):
    flt = make_state_filter(DEFAULT_CAR, config, chassis=chassis)
    scaled, nees = [], []
    for t, state in run_filter(flt, drive):
        if t < SETTLED_NS or (t - SETTLED_NS) % SAMPLE_NS:
            continue
        estimate = predict_to(flt, state, t)
        error = np.array(estimate.state) - np.array(drive.truth[t])
        scaled.append(error / np.array(estimate.sd))
        nees.append(error @ np.linalg.solve(estimate.belief.covariance, error))
    nodes = [node for node in state.nodes if node.measurement.t_ns > SETTLED_NS]
    nis = {kind: [n.nis for n in nodes if n.measurement.kind is kind] for kind in Kind}
    return Record(np.array(scaled), np.array(nees), nis, sum(not n.believed for n in nodes))


@pytest.fixture(scope="module")
def drives(simulate: Any) -> list[Any]:
    return [simulate(seed, SECONDS, config=CONFIG, gyro=True) for seed in range(1000, 1000 + RUNS)]


@pytest.fixture(scope="module")
def records(drives: list[Any], run_filter: Any) -> list[Record]:
    return [record(drive, run_filter, CONFIG) for drive in drives]


def hard_slalom(t: float) -> Command[float]:
    """Bends of up to 9 m/s^2 either way, at 3.4 to 4.6 m/s."""
    steer = 0.15 * math.sin(2.0 * math.pi * 0.6 * t)
    return Command(steer, 4.0 + 0.6 * math.sin(2.0 * math.pi * 0.4 * t))


@pytest.fixture(scope="module")
def hard_drives(simulate: Any) -> list[Any]:
    first = ORIGIN._replace(speed=4.0)
    asked = {"config": CONFIG, "first": first, "gyro": True, "chassis": PLANAR}
    return [simulate(2000 + n, SECONDS, hard_slalom, **asked) for n in range(RUNS)]


def within(total: float, freedom: int, confidence: float = 0.99) -> bool:
    low, high = chi2.ppf([0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], freedom)
    return bool(low <= total <= high)


def total_nees(records: Iterable[Record]) -> tuple[float, int]:
    nees = np.concatenate([r.nees for r in records])
    return float(nees.sum()), 7 * nees.size


def total_nis(records: Iterable[Record], kind: Kind) -> tuple[float, int]:
    values = [value for r in records for value in r.nis[kind]]
    return sum(values), WIDTHS[kind] * len(values)


def test_nees_lies_within_its_bounds_in_all_and_at_every_instant(records):
    """One of nine instants may stray: that happens to 8 % of consistent filters, two to 0.3 %."""
    assert within(*total_nees(records))
    instants = np.sum([r.nees for r in records], axis=0)
    assert instants.size == 9
    assert sum(not within(float(total), 7 * RUNS) for total in instants) <= 1


@pytest.mark.parametrize("index", range(7), ids=State._fields)
def test_each_state_has_unit_variance_and_no_bias(records, index):
    scaled = np.concatenate([r.scaled[:, index] for r in records])
    assert within(float((scaled**2).sum()), scaled.size, 0.999)
    assert abs(scaled.mean()) < 3.3 / np.sqrt(scaled.size)


@pytest.mark.parametrize("kind", list(Kind))
def test_nis_lies_within_its_bounds(records, kind):
    assert within(*total_nis(records, kind))


def test_gates_refuse_about_one_in_a_thousand(records):
    seen = sum(len(values) for r in records for values in r.nis.values())
    refused = sum(r.refused for r in records)
    assert chi2.ppf(0.005, 2 * refused) / 2 < 0.001 * seen < chi2.ppf(0.995, 2 * refused + 2) / 2


def test_a_planar_car_in_tight_bends(hard_drives, run_filter):
    """Its own equations are consistent there; small angles and wheels without slip are not."""
    fastest = max(abs(s.speed * s.yaw_rate) for d in hard_drives for s in d.truth.values())
    assert fastest > 8.0
    own = [record(drive, run_filter, CONFIG, PLANAR) for drive in hard_drives]
    assert within(*total_nees(own))
    assert all(within(*total_nis(own, kind)) for kind in Kind)
    other = [record(drive, run_filter, CONFIG) for drive in hard_drives[:8]]
    nees, freedom = total_nees(other)
    assert nees > 2.0 * freedom


@pytest.mark.parametrize("factor", [0.6, 1.6])
@pytest.mark.parametrize("name", ["yaw_accel_density", "longitudinal_accel_density"])
def test_a_wrong_process_noise_is_noticed(drives, run_filter, name, factor):
    wrong = replace(CONFIG, **{name: factor * getattr(CONFIG, name)})
    some = [record(drive, run_filter, wrong) for drive in drives[:8]]
    checks = [within(*total_nees(some)), *(within(*total_nis(some, kind)) for kind in Kind)]
    assert not all(checks)
