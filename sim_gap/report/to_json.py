"""The diagnosis as the schema `steerd.gap/1`."""

from dataclasses import asdict
from typing import Any

from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.verdict.evidence import Cause, Estimated
from steerd.sysid.inference.residuals import Gap
from steerd.sysid.report.report import finite

SCHEMA = "steerd.gap/1"


def _gap(gap: Gap) -> dict[str, Any]:
    names = ("position_mm", "yaw_mrad", "speed_m_s")
    scales = (1e3, 1e3, 1.0)
    leads = []
    for row, bounds in zip(gap.errors, gap.intervals, strict=True):
        entry: dict[str, Any] = {"lead_s": row[0]}
        for name, scale, value, (low, high) in zip(names, scales, row[1:], bounds, strict=True):
            entry[name] = {"value": scale * value, "low": scale * low, "high": scale * high}
        leads.append(entry)
    low, high = gap.interval
    return {"whitened": gap.whitened, "low": low, "high": high, "errors": leads}


def _gap_values(found: Diagnosis, which: str) -> dict[str, Any]:
    """A gap with its whitened error over other horizons."""
    horizons = [
        {"horizon_s": each.seconds, "whitened": getattr(each, which)} for each in found.horizons
    ]
    return {**_gap(getattr(found, which)), "horizons": horizons}


def _cause(cause: Cause, found: Diagnosis) -> dict[str, Any]:
    s = found.shrinkage
    return {
        "effect": cause.effect, "stage": cause.stage, "family": cause.family,
        "parameters": {n: Estimated(*each)._asdict() for n, each in cause.parameters.items()},
        "confidence": cause.confidence,
        "shrink": {
            "predicted": s.predicted, "measured": s.measured, "low": s.low, "high": s.high,
        },
        "ambiguous_with": list(cause.ambiguous_with),
    }  # fmt: skip


def to_json(found: Diagnosis) -> dict[str, Any]:
    """The diagnosis as plain values, exactly in the shape of `steerd.gap/1`."""
    following = found.next_manoeuvre
    return dict(finite({
        "schema": SCHEMA,
        "verdict": found.verdict,
        "gap": {"before": _gap_values(found, "before"), "after": _gap_values(found, "after")},
        "where": asdict(found.where),
        "causes": [_cause(cause, found) for cause in found.causes],
        "candidates": [
            {"effect": n, "probability": p, "gain": g} for n, p, g in found.candidates
        ],
        "something_else": found.something_else,
        "next_manoeuvre": {} if following is None else asdict(following),
        "residual": _residual(found),
    }))  # fmt: skip


def _residual(found: Diagnosis) -> dict[str, Any]:
    s, shape = found.shrinkage, found.shape
    return {
        "spectrum_peak_hz": shape.peak_hz, "prominence": shape.prominence,
        "dependence": shape.dependence, "noise_like": shape.noise_like,
        "noise": {"instruments": list(found.noise.instruments), "pushes": list(found.noise.pushes),
                  "known": found.noise_known},
        "moved": found.moved,
        "aliases": {c.effect: c.alias for c in found.causes if c.alias},
        "prediction_sha256": s.digest,
        "held_out": None if s.before is None or s.after is None else {
            "before": _gap(s.before), "after": _gap(s.after)
        },
        "notes": list(found.notes),
    }  # fmt: skip
