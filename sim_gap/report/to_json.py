"""The diagnosis as the schema `steerd.gap/1`."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from steerd.sim_gap.diagnosis import Diagnosis
from steerd.sim_gap.lane_comparison import encode_lane
from steerd.sysid.inference.residuals import Gap
from steerd.sysid.report.report import finite

SCHEMA = "steerd.gap/1"


def _gap(gap: Gap) -> dict[str, Any]:
    kinds, leads = (("position_mm", 1e3), ("yaw_mrad", 1e3), ("speed_m_s", 1.0)), []
    for seconds, *errors in gap.errors:
        entry: dict[str, Any] = {"lead_s": seconds}
        for (name, scale), error in zip(kinds, errors, strict=True):
            entry[name] = {key: scale * value for key, value in error._asdict().items()}
        leads.append(entry)
    low, high = gap.interval
    return {"whitened": gap.whitened, "low": low, "high": high, "errors": leads}


def to_json(found: Diagnosis, complete: Callable[[str], str] = str) -> dict[str, Any]:
    """The diagnosis as plain values, exactly in the shape of `steerd.gap/1`.

    What it rests on is under `residual`; `complete` makes a command run as it is printed.
    """
    s, shape, case, following = found.shrinkage, found.shape, found.case, found.next_manoeuvre
    horizons = {
        which: [
            {"horizon_s": each.seconds, "whitened": getattr(each, which)} for each in found.horizons
        ]
        for which in ("before", "after")
    }
    return dict(finite({
        "schema": SCHEMA,
        "verdict": found.verdict,
        "gap": {n: {**_gap(getattr(found, n)), "horizons": rows} for n, rows in horizons.items()},
        "where": asdict(found.where),
        "causes": [
            {
                "effect": cause.effect, "stage": cause.stage, "family": cause.family,
                "parameters": {name: each._asdict() for name, each in cause.parameters.items()},
                "confidence": cause.confidence,
                "shrink": {
                    name: getattr(s, name) for name in ("predicted", "measured", "low", "high")
                },
                "ambiguous_with": cause.ambiguous_with,
            }
            for cause in found.causes
        ],
        "candidates": [
            {"effect": n, "probability": p, "gain": g} for n, p, g in found.candidates
        ],
        "something_else": found.something_else,
        "next_manoeuvre": {} if following is None else {
            **asdict(following), "command": complete(following.command)
        },
        "residual": {
            "spectrum_peak_hz": shape.peak_hz, "prominence": shape.prominence,
            "dependence": shape.dependence, "noise_like": shape.noise_like,
            "noise": {"instruments": found.noise.instruments, "pushes": found.noise.pushes,
                      "known": found.noise_known},
            "moved": found.moved,
            "aliases": {c.effect: c.alias for c in found.causes if c.alias},
            "prediction_sha256": s.digest,
            "held_out": None if s.before is None or s.after is None else {
                "before": _gap(s.before), "after": _gap(s.after)
            },
            "notes": found.all_notes,
            "sessions": case.sessions,
            "base": case.base_source,
            "held_out_of": case.held_out_of or None,
            "prediction": s.text,
            "closed_loop": None if found.lane is None else encode_lane(found.lane),
        },
    }))  # fmt: skip
