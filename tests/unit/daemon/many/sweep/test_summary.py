"""The figures of a sweep's page, on tables whose answers are known."""

import numpy as np
import pytest

from steerd.daemon.many.sweep.plan import list_cases
from steerd.daemon.many.sweep.run import Sweep
from steerd.daemon.many.sweep.summary import STOPS, make_share

N = 200


@pytest.fixture(scope="module")
def summary(make_plan):
    """Errors that grow with the delay, stops on one path, a mass that moves nothing."""
    vary = {
        "path": ["line", "figure8"],
        "effect.steer_delay": {"low": 0.0, "high": 0.04},
        "car.mass": {"share": 0.1},
    }
    plan, rng = make_plan(vary, seeds=N // 2), np.random.default_rng(3)
    rows = []
    for case in list_cases(plan):
        stopped = case.values["path"] == "figure8" and case.values["effect.steer_delay"] > 0.03
        row = {"drive": case.number, "seed": case.seed, **case.values}
        row |= {"outcome": "stopped" if stopped else "driven", "seconds": 5.0}
        row |= {"watchdog": "W17" if stopped else "", "damping": 0.5}
        row["e1_rms"] = None if stopped else 1e-3 + case.values["effect.steer_delay"] ** 2
        row["steer_margin"] = rng.random()
        rows.append(row)
    return Sweep(tuple(rows), 0, 0.0, plan), rows


def find(summary, quantity, measure):
    return next(s for s in summary.sensitivities if (s.quantity, s.measure) == (quantity, measure))


def test_what_moves_what_is_found_and_the_rest_is_not_shown(summary):
    found, _ = summary
    moved = find(found, "effect.steer_delay", "e1_rms")
    assert moved.value == pytest.approx(1.0)
    assert moved.shown
    assert moved.start == pytest.approx(1.02e-3, abs=0.02e-3), "over the lowest fifth of delays"
    assert moved.end == pytest.approx(2.15e-3, abs=0.2e-3)
    assert find(found, "path", STOPS).shown
    assert find(found, "effect.steer_delay", STOPS).value > 0.3
    assert abs(find(found, "car.mass", "steer_margin").value) < 0.2
    assert all(s.measure != "damping" for s in found.sensitivities), "it never varied"


def test_stops_are_counted_with_their_interval(summary):
    found, rows = summary
    stops = sum(row["outcome"] == "stopped" for row in rows)
    share = next(s for s in found.outcomes if s.name == "stopped")
    assert (share.count, share.of) == (stops, N)
    assert [(s.name, s.count) for s in found.watchdogs] == [("W17", stops)]


def test_the_worst_drive_is_named(summary):
    found, rows = summary
    spread = next(s for s in found.spreads if s.name == "e1_rms")
    largest = max(row["e1_rms"] or 0.0 for row in rows)
    assert rows[spread.worst_drive]["e1_rms"] == spread.worst == largest
    margin = next(s for s in found.spreads if s.name == "steer_margin")
    assert margin.worst == min(row["steer_margin"] for row in rows), "small margins are bad"
    assert margin.low < margin.middle < margin.high


@pytest.mark.parametrize(
    ("count", "total", "low", "high"),
    [(0, 100, 0.0, 0.0370), (100, 100, 0.9630, 1.0), (5, 10, 0.2366, 0.7634)],
)
def test_shares_have_wilsons_interval(count, total, low, high):
    share = make_share("x", count, total)
    assert share.low == pytest.approx(low, abs=1e-4)
    assert share.high == pytest.approx(high, abs=1e-4)
