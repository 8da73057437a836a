"""Scores of hand-made verdicts are the numbers worked out by hand."""

import json
from math import isnan, nan

import pytest

from benchmarks.blind_gap.score import Rate, score
from benchmarks.blind_gap.verdicts import Cause, Verdict, read_verdict

N = iter(range(1000))


STRENGTHS = {"steer_bias": 0.015, "mass": 1.5, "cog_offset": 0.015}


def label(kind, effects=(), size="medium", block="single-rich", control="", outside="", values=()):
    truths = [
        {"effect": e, "size": size, "parameters": v, "strength": STRENGTHS.get(e, 1.0)}
        for e, v in zip(effects, values or [{}] * len(effects), strict=True)
    ]
    return {
        "name": f"c{next(N)}", "kind": kind, "block": block, "truths": truths, "size": size,
        "control": control, "outside": outside,
    }  # fmt: skip


def cause(effect, confidence=0.9, value=None, shrink=(nan, nan), others=()):
    values = {} if value is None else value
    return Cause(effect, confidence, values, *shrink, tuple(others))


def told(*causes, verdict="explained", seconds=1.0):
    return Verdict(verdict, causes, seconds)


NONE = Verdict("none", (), 2.0)


def scored(*pairs):
    return score(
        [entry for entry, _ in pairs], {entry["name"]: v for entry, v in pairs if v is not None}
    )


def singles():
    delay = [{"delay": 0.04}]
    return [
        (label("single", ["steer_delay"], values=delay),
         told(cause("steer_delay", 0.95, {"delay": 0.05}, (0.9, 0.8)), seconds=1.0)),
        (label("single", ["steer_delay"], values=delay),
         told(cause("steer_lag", 0.55, others=["steer_delay"]), seconds=3.0)),
        (label("single", ["steer_delay"], values=delay),
         told(cause("mocap_latency", 0.55, shrink=(0.5, 0.53)), seconds=9.0)),
        (label("single", ["steer_delay"], values=delay), NONE),
    ]  # fmt: skip


def test_singles():
    s = scored(*singles())
    row = "rich, medium"
    assert s.detection[row] == Rate(3, 4)
    assert s.naming[row] == Rate(1, 3)
    assert s.naming[f"{row}: family"] == Rate(2, 3)
    assert s.coverage[row] == Rate(2, 3)
    assert s.set_size[row] == pytest.approx(4 / 3)
    assert (s.parameters.median, s.parameters.count) == (pytest.approx(0.25), 1)
    assert s.shrinkage.median == pytest.approx(6.5)
    assert s.shrinkage.p90 == pytest.approx(9.3)
    assert s.seconds == pytest.approx((2.5, 7.2, 9.0))
    assert s.by_effect["steer_delay"][:2] == (Rate(3, 4), Rate(1, 3))


def test_calibration():
    s = scored(*singles())
    assert [(b.count, b.right) for b in s.reliability.bins] == [(2, 0.0), (1, 1.0)]
    assert s.reliability.ece == pytest.approx((2 * 0.55 + 0.05) / 3)
    assert s.reliability.count == 3
    assert s.reliability.brier_plain == pytest.approx(2 / 9)
    low, high = s.reliability.ece_interval
    assert low < s.reliability.ece < high


def test_nulls_count_alarms_and_missing_verdicts():
    nulls = [(label("null", block="null-rich"), v) for v in (NONE, NONE, told(cause("mass")), None)]
    s = scored(*nulls)
    assert s.alarms["all nulls"] == Rate(2, 4)
    assert s.alarms["a cause named"] == Rate(1, 4)
    assert s.missing == 1


def test_pairs_look_at_two_causes():
    truth = ["steer_bias", "mass"]
    answers = [
        told(cause("mass"), cause("steer_bias")),
        told(cause("mass"), cause("scrub"), cause("steer_bias")),
        told(cause("scrub"), cause("drive_lag"), cause("mass")),
        NONE,
    ]
    s = scored(*((label("pair", truth, block="pair-random"), v) for v in answers))
    assert list(s.pairs.values())[:3] == [Rate(3, 4), Rate(1, 4), Rate(2, 4)]
    weak = label("pair", ["steer_bias", "cog_offset"], block="pair-random")
    s = scored((weak, NONE), (label("pair", truth, block="pair-random"), answers[0]))
    assert list(s.pairs.values()) == [Rate(1, 2), Rate(1, 2), Rate(1, 2), Rate(1, 1), Rate(0, 1)]


def test_outside_counts_confident_names_only():
    answers = [
        told(cause("mass", 0.85)),
        told(cause("mass", 0.6)),
        told(cause("mass", 0.9), verdict="partial"),
        told(verdict="unexplained"),
        NONE,
    ]
    entries = [label("outside", outside="x", block="outside-rich") for _ in answers]
    s = scored(*zip(entries, answers, strict=True))
    assert list(s.outside.values()) == [Rate(4, 5), Rate(1, 5), Rate(2, 5), Rate(2, 4)]


def test_vector_parameters_and_nulls():
    slope = {"x": 0.003, "y": 0.004}
    entry = label("single", ["floor_slope"], values=[slope])
    s = scored((entry, told(cause("floor_slope", value={"x": 0.003, "y": 0.005}))))
    assert s.parameters.median == pytest.approx(0.2)
    gain = label("single", ["steer_gain"], values=[{"gain": 1.2}])
    s = scored((gain, told(cause("steer_gain", value={"gain": 1.19}))))
    assert s.parameters.median == pytest.approx(0.05)
    other = label("single", ["tyre_friction"], values=[{"ratio": 0.8}])
    s = scored((other, told(cause("tyre_friction", value={"ratio": 0.7}))))
    assert s.parameters.count == 0


def test_wilson_interval():
    low, high = Rate(8, 10).interval
    assert (low, high) == (pytest.approx(0.4902, abs=1e-4), pytest.approx(0.9433, abs=1e-4))
    assert isnan(Rate(0, 0).value)


VERDICT = {
    "schema": "steerd.gap/1",
    "verdict": "explained",
    "causes": [
        {
            "effect": "steer_delay",
            "parameters": {"delay": {"value": 0.03, "sd": 0.001, "unit": "s"}},
            "confidence": 0.97,
            "shrink": {"predicted": 0.9, "measured": 0.88, "low": 0.8, "high": 0.95},
            "ambiguous_with": ["mocap_latency", {"effect": "steer_lag"}],
        }
    ],
}


def test_reads_the_contract():
    verdict = read_verdict(json.dumps(VERDICT), 4.0)
    first = verdict.first
    assert first is not None
    assert (first.effect, first.confidence, first.parameters) == (
        "steer_delay",
        0.97,
        {"delay": 0.03},
    )
    assert (first.predicted, first.measured) == (0.9, 0.88)
    assert verdict.suspects == {"steer_delay", "mocap_latency", "steer_lag"}
    assert read_verdict(json.dumps({**VERDICT, "verdict": "none"})).first is None
