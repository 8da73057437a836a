"""What an identification came to: the fitted car, and the outcome for screen, JSON and report.

A `Fit` is what our method found and how sure it is; an `Outcome` is the result of any method.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, isnan, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import CarFile
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.native.windows import parameter_vector
from steerd.car_model.params import PARAMETERS, Car
from steerd.sysid.data.dataset import LogJitter, Run
from steerd.sysid.data.excitation import Excitation
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.estimation.command_timing import Pulse, Ramp
from steerd.sysid.estimation.validation import Prediction, Regime, Trace
from steerd.sysid.inference.car_fit import FittedCar, Step
from steerd.sysid.inference.car_posterior import base_prior_of, car_file_of, describe_misfits
from steerd.sysid.inference.identifiability import (
    MANOEUVRES,
    RELATIVE_MAX,
    Combination,
    Estimate,
    combinations,
    estimates,
    fitted_estimates,
    silent_estimates,
)
from steerd.sysid.inference.noise import signal_noise
from steerd.sysid.inference.plain_car import PlainCar, covariance_of, misfit_of, silent_names
from steerd.sysid.inference.predictor import HORIZON, Predictor
from steerd.sysid.inference.search import with_size
from steerd.sysid.inference.space import Asked
from steerd.sysid.paper.search_history import NAMES, SearchHistory

Array = NDArray[np.float64]

SCHEMA = "steerd.identify/1"
REPORTED: tuple[str, ...] = (
    "lf", "lr", "c_sf", "c_sr", "mu", "inertia_z", "mass", "steer_gain", "steer_bias",
    "steer_delay", "steer_lag", "steer_rate", "speed_gain", "speed_lag",
)  # fmt: skip
"""Parameters of the JSON result."""


class Residuals(NamedTuple):
    """Measurements minus predictions of all windows.

    Attributes:
        t: (R,) time into the drive [s].
        group: (R,) which kind, see `windows.GROUPS`.
        error: (R,) in units.
        signal: (4,) noise of the signals themselves.
    """

    t: Array
    group: NDArray[np.int64]
    error: Array
    signal: Array


@dataclass(frozen=True, eq=False)
class Fit:
    """An identified car.

    Attributes:
        model: the car with its effects at the estimates.
        estimates: every free parameter with standard error and whether the data identify it.
        labels: of the coordinates; correlation: (n, n) of them.
        converged: whether the search came to its end.
        misfit: residual over signal noise by group: 1 says that the model explains everything.
        residuals: of the windows.
        horizon: length of the windows [s].
        combinations: sums that the data fix even where they leave their members open.
        selected: effects that the drives show, those that every car has aside.
        sections: tables for the car file beside its numbers, where they were learnt with it.
        notes: what a person should know.
    """

    model: Model[float]
    estimates: dict[str, Estimate]
    labels: tuple[str, ...]
    correlation: Array
    converged: bool
    misfit: dict[str, float]
    residuals: Residuals
    horizon: float
    combinations: tuple[Combination, ...] = ()
    selected: tuple[Step, ...] = ()
    sections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def fit_of_plain(
    found: PlainCar, runs: Sequence[Run], asked: Asked, doubts: Sequence[tuple[str, float]]
) -> Fit:
    """What a plain car's optimum says.

    Args:
        found: the optimum.
        runs: its drives.
        asked: what was asked of them; names that they cannot show are reported as open.
        doubts: see `plain_car.covariance_of`.
    """
    chart, z = found.chart, found.point.z
    covariance = covariance_of(found, doubts)
    pace = float(np.median(np.abs(np.concatenate([run.commands[:, 1] for run in runs]))))
    pace *= float(found.point.parameters[chart.names.index("speed_gain")])
    known = estimates(chart, z, covariance)
    error = found.point.linear.error
    horizon = float(found.predictor.layout.spans[:, 3].mean() * runs[0].h)
    return Fit(
        model=_moved(asked.model, known),
        estimates=known | silent_estimates(chart, silent_names(runs, asked.free)),
        labels=chart.labels,
        correlation=_correlation(covariance),
        converged=found.point.whole,
        misfit=found.misfit,
        residuals=_residuals(found.predictor, error, np.array(found.noise.instruments)),
        horizon=horizon,
        combinations=combinations(chart, z, covariance, pace),
    )


def fit_of_car(
    fitted: FittedCar, base: Model[float], runs: Sequence[Run], doubts: Sequence[tuple[str, float]]
) -> Fit:
    """What a car says that windows of one second show, disturbances known.

    Args:
        fitted: the car.
        base: what the fit began at.
        runs: its drives.
        doubts: see `plain_car.covariance_of`.
    """
    file = CarFile(
        Path("fitted.toml"), "fitted", base.car, base.effects, base.values, chassis=base.chassis
    )
    found = car_file_of(file, fitted)
    kept = {effect.name for effect in found.effects}
    own = {f"{e.name}.{p.name}" for e in found.effects for p in e.parameters}
    sds = {name: sd for name, sd in found.sd.items() if "." not in name or name in own}
    sds |= {name: float(np.hypot(sds[name], sd)) for name, sd in doubts if name in sds}
    signal = signal_noise(estimate_noise(runs))
    at = with_size(fitted.likelihood, fitted.point, 0.0)
    predictor, error = fitted.likelihood.predictor, at.linear.error
    return Fit(
        model=found.model,
        estimates=fitted_estimates(found.effects, parameter_vector(found.model), sds),
        labels=fitted.point.space.chart.labels,
        correlation=_correlation(base_prior_of(fitted).covariance),
        converged=fitted.point.whole,
        misfit=misfit_of(predictor, error, signal),
        residuals=_residuals(predictor, error, np.array(signal.instruments)),
        horizon=HORIZON,
        selected=tuple(step for step in fitted.selected if step.effect in kept),
        sections=found.sections,
        notes=describe_misfits(fitted, runs),
    )


def _moved(model: Model[float], known: Mapping[str, Estimate]) -> Model[float]:
    """The model at the estimates."""
    values = tuple(
        tuple(
            known[f"{e.name}.{p.name}"].value if f"{e.name}.{p.name}" in known else value
            for p, value in zip(e.parameters, own, strict=True)
        )
        for e, own in zip(model.effects, model.values, strict=True)
    )
    car = model.car._replace(**{n: e.value for n, e in known.items() if "." not in n})
    return model._replace(car=car, values=values)


def _correlation(covariance: Array) -> Array:
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def _residuals(predictor: Predictor, error: Array, signal: Array) -> Residuals:
    """Errors (W, D) as rows, those of means as large as single readings' would be."""
    layout, there = predictor.layout, predictor.padded.there > 0.0
    row = predictor.padded.row[there]
    window = np.repeat(np.arange(len(there)), there.sum(axis=1))
    t = layout.t[window] + layout.row_t[row]
    return Residuals(
        t, layout.group[row], (error * np.sqrt(predictor.padded.merged))[there], signal
    )


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
