"""What an identification came to, whatever the method: for the screen, JSON and the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, isnan, nan
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.params import PARAMETERS, Car
from steerd.sysid.data.dataset import LogJitter
from steerd.sysid.data.excitation import Excitation
from steerd.sysid.estimation.command_timing import Pulse, Ramp
from steerd.sysid.estimation.fit import Fit
from steerd.sysid.estimation.validation import Prediction, Regime, Trace
from steerd.sysid.inference.identifiability import MANOEUVRES, RELATIVE_MAX, Combination, Estimate
from steerd.sysid.inference.teaching import Step
from steerd.sysid.paper.search_history import NAMES, SearchHistory

SCHEMA = "steerd.identify/1"
REPORTED: tuple[str, ...] = (
    "lf", "lr", "c_sf", "c_sr", "mu", "inertia_z", "mass", "steer_gain", "steer_bias",
    "steer_delay", "steer_lag", "steer_rate", "speed_gain", "speed_lag",
)  # fmt: skip
"""Parameters of the JSON result."""


class Row(NamedTuple):
    """One parameter.

    Attributes:
        value: now; before: at the start.
        sd: standard error; None where it was not free.
        unit: of value and sd.
        free: whether it was fitted.
        identifiable: whether the data identify it.
        manoeuvre: what would identify it; empty when identifiable or fixed.
    """

    value: float
    before: float
    sd: float | None
    unit: str
    free: bool
    identifiable: bool
    manoeuvre: str = ""

    @property
    def start(self) -> float:
        """The value before."""
        return self.before


class HeldOut(NamedTuple):
    """Prediction errors at one horizon, after and before."""

    after: Prediction
    before: Prediction

    @property
    def factor(self) -> float:
        """How many times smaller the position error has become."""
        return self.before.position / max(self.after.position, 1e-12)


@dataclass(frozen=True, eq=False)
class Outcome:
    """An identification.

    Attributes:
        method: `ours`, `paper` or `cma-es`.
        sessions: fitted files.
        held_out_of: what the prediction errors were measured on, in words.
        before, after: the car.
        rows: every parameter of the car; effect_rows: those of its effects that were free, as
            `effect.parameter`.
        held_out: prediction errors.
        excitation: of the fitted drives.
        traces: predictions of the held-out drives, after and before.
        fit: of our method.
        searches: each start of a search.
        seconds: how long the fit took.
        notes: what a person should know.
        truth: the simulated car, where the sessions are simulated.
        pulses: phases of the servo's pulses, by drive.
        ramps: limits of the motor controller's setpoint, by drive.
        log_jitters: how late slow logs stored the steering, by drive.
        regimes: prediction errors after 1 s by lateral acceleration.
    """

    method: str
    sessions: tuple[str, ...]
    held_out_of: str
    before: Car[float]
    after: Car[float]
    rows: dict[str, Row]
    held_out: tuple[HeldOut, ...]
    excitation: Excitation
    traces: tuple[list[Trace], list[Trace]]
    fit: Fit | None = None
    searches: tuple[SearchHistory, ...] = ()
    seconds: float = 0.0
    notes: tuple[str, ...] = ()
    truth: Car[float] | None = None
    pulses: tuple[Pulse, ...] = ()
    ramps: tuple[Ramp, ...] = ()
    effect_rows: dict[str, Row] = field(default_factory=dict)
    log_jitters: tuple[LogJitter, ...] = ()
    regimes: tuple[Regime, ...] = ()

    def __repr__(self) -> str:
        return f"<Outcome of {', '.join(self.sessions)}>"

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """Sums that the data fix."""
        return self.fit.combinations if self.fit else ()

    @property
    def selected_effects(self) -> tuple[Step, ...]:
        """Effects that the drives showed, those that every car has aside."""
        return self.fit.selected if self.fit else ()

    @property
    def sections(self) -> Mapping[str, Mapping[str, Any]]:
        """Tables that were learnt with the car, for its file; empty where they were not."""
        return self.fit.sections if self.fit else {}

    @property
    def free_rows(self) -> dict[str, Row]:
        """What was fitted."""
        return {n: r for n, r in (self.rows | self.effect_rows).items() if r.free}

    @property
    def unidentified(self) -> dict[str, str]:
        """Free parameters that the data leave open, and what would identify them."""
        return {n: r.manoeuvre for n, r in self.free_rows.items() if not r.identifiable}


def _number(value: float | None) -> float | None:
    return None if value is None or isnan(value) else value


def encode_outcome(outcome: Outcome) -> dict[str, Any]:
    """The outcome as JSON values: schema `steerd.identify/1`; what is not known is null."""
    rows = {name: outcome.rows[name] for name in REPORTED} | outcome.effect_rows
    return {
        "schema": SCHEMA,
        "parameters": {
            name: {
                "value": row.value,
                "sd": _number(row.sd),
                "unit": row.unit,
                "identifiable": row.identifiable,
            }
            for name, row in rows.items()
        },
        "combinations": [c.__dict__ for c in outcome.combinations],
        "held_out": {
            "horizons": [
                {
                    "horizon": h.after.horizon,
                    "position": _number(h.after.position),
                    "heading": _number(h.after.heading),
                    "position_before": _number(h.before.position),
                    "heading_before": _number(h.before.heading),
                }
                for h in outcome.held_out
            ],
            "regimes": [
                {
                    "lateral_accel_low": r.low,
                    "lateral_accel_high": r.high if isfinite(r.high) else None,
                    "predictions": r.windows,
                    "median": r.median,
                    "rms": r.rms,
                }
                for r in outcome.regimes
            ],
        },
        "excitation": outcome.excitation._asdict(),
        "converged": None if outcome.fit is None else outcome.fit.converged,
        "misfit": None if outcome.fit is None else outcome.fit.misfit,
        "notes": list(outcome.notes),
    }


def make_rows(
    given: Car[float], after: Car[float], known: Mapping[str, Estimate]
) -> dict[str, Row]:
    """A row for each parameter of the car; what is not among the estimates was not free."""
    return {
        p.name: _row(getattr(after, p.name), getattr(given, p.name), p.unit, known.get(p.name))
        for p in PARAMETERS
    }


def make_effect_rows(
    start: Model[float], after: Model[float], known: Mapping[str, Estimate]
) -> dict[str, Row]:
    """A row for each free parameter of the effects that the car came out with."""
    before = {
        f"{e.name}.{p.name}": value
        for e, values in zip(start.effects, start.values, strict=True)
        for p, value in zip(e.parameters, values, strict=True)
    }
    rows = {}
    for effect in after.effects:
        for p in EFFECTS[effect.name].parameters:
            name = f"{effect.name}.{p.name}"
            if name in known:
                found = known[name]
                rows[name] = _row(found.value, before.get(name, p.null), p.unit, found)
    return rows


def _row(value: float, before: float, unit: str, found: Estimate | None) -> Row:
    if found is None:
        return Row(float(value), float(before), None, unit, False, False)
    sd = None if np.isnan(found.sd) else found.sd
    return Row(float(value), float(before), sd, unit, True, found.identifiable, found.manoeuvre)


def searched_estimates(searches: Sequence[SearchHistory]) -> dict[str, Estimate]:
    """What the searches of the paper's methods found.

    A search has no standard error; the spread over its starts stands for it.
    """
    sound = [search for search in searches if not search.diverged]
    best = min(sound, key=lambda search: float(search.losses[-20:].mean())).final
    finals = np.array([search.final for search in sound])
    spread = finals.std(axis=0, ddof=1) if len(finals) > 1 else np.full(len(NAMES), nan)
    out = {}
    for name, value, sd in zip(NAMES, best.tolist(), spread.tolist(), strict=True):
        known = sd < RELATIVE_MAX * value
        out[name] = Estimate(value, sd, known, "" if known else MANOEUVRES[name])
    return out
