"""What an identification came to: the fitted car, and the outcome for screen, JSON and report.

A `Fit` is what our method found and how sure it is; an `Outcome` is the result of any method.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.model import Model
from steerd.car_model.native.trace import parameter_names
from steerd.car_model.native.windows import parameter_vector
from steerd.car_model.params import PARAMETERS, Car
from steerd.sysid.data.data_checks import Array, Indices
from steerd.sysid.data.dataset import LogJitter, Pulse, Ramp, Run
from steerd.sysid.data.excitation import Excitation
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.estimation.validation import Prediction, Regime, Trace
from steerd.sysid.inference import identifiability
from steerd.sysid.inference.car_fit import FittedCar, Step
from steerd.sysid.inference.car_posterior import describe_lost, file_of_fitted, knowledge_of
from steerd.sysid.inference.identifiability import Combination, Estimate
from steerd.sysid.inference.noise import Noise, signal_noise
from steerd.sysid.inference.plain_car import Asked, PlainCar, covariance_of, misfit_of, silent_names
from steerd.sysid.inference.predictor import HORIZON, Predictor
from steerd.sysid.inference.search import with_size
from steerd.sysid.paper import NAMES, SearchHistory

SCHEMA = "steerd.identify/1"
REPORTED: tuple[str, ...] = (
    "lf", "lr", "c_sf", "c_sr", "mu", "inertia_z", "mass", "steer_gain", "steer_bias",
    "steer_delay", "steer_lag", "steer_rate", "speed_gain", "speed_lag",
)  # fmt: skip
"""Parameters of the JSON result."""


class Residuals(NamedTuple):
    """Measurements minus predictions of all windows."""

    t: Array  # (R,) time into the drive [s]
    group: Indices  # (R,) which kind, see `windows.GROUPS`
    error: Array  # (R,) in units
    signal: Array  # (4,) noise of the signals themselves


@dataclass(frozen=True, eq=False)
class Fit:
    """An identified car."""

    model: Model[float]  # the car with its effects at the estimates
    estimates: dict[str, Estimate]  # every free parameter, its error, whether it is identified
    labels: tuple[str, ...]  # of the coordinates; correlation: (n, n) of them
    correlation: Array
    converged: bool  # whether the search came to its end
    misfit: dict[str, float]  # residual over signal noise by group: 1 where all is explained
    residuals: Residuals  # of the windows
    horizon: float  # length of the windows [s]
    combinations: tuple[Combination, ...] = ()  # sums that are known where members are open
    selected: tuple[Step, ...] = ()  # effects that the drives show, those that every car has aside
    # Tables for the car file beside its numbers, where they were learnt with it
    sections: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what a person should know


def fit_of_plain(
    found: PlainCar, runs: Sequence[Run], asked: Asked, doubts: Sequence[tuple[str, float]]
) -> Fit:
    """What a plain car's optimum on its drives says; `doubts` as for `plain_car.covariance_of`.

    Names that are asked of the drives and that they cannot show are reported as open.
    """
    chart, z = found.point.space.chart, found.point.z
    covariance = covariance_of(found, doubts)
    pace = float(np.median(np.abs(np.concatenate([run.commands[:, 1] for run in runs]))))
    pace *= float(found.point.parameters[chart.names.index("speed_gain")])
    known = identifiability.estimates(chart, z, covariance)
    at = {name: e.value for name, e in known.items()}
    values = tuple(
        tuple(at.get(f"{e.name}.{p.name}", v) for p, v in zip(e.parameters, own, strict=True))
        for e, own in zip(asked.model.effects, asked.model.values, strict=True)
    )
    car = asked.model.car._replace(**{name: at[name] for name in at if "." not in name})
    return Fit(
        model=asked.model._replace(car=car, values=values),
        estimates=known | identifiability.silent_estimates(chart, silent_names(runs, asked.free)),
        labels=chart.labels,
        correlation=_correlation(covariance),
        converged=found.point.whole,
        misfit=found.misfit,
        residuals=_residuals(found.predictor, found.point.linear.error, found.noise),
        horizon=float(found.predictor.layout.spans[:, 3].mean() * runs[0].h),
        combinations=identifiability.combinations(chart, z, covariance, pace),
    )


def fit_of_windows(
    fitted: FittedCar, base: Model[float], runs: Sequence[Run], doubts: Sequence[tuple[str, float]]
) -> Fit:
    """What a car says that windows of one second fitted, from a base on, disturbances known."""
    file = CarFile(
        Path("fitted.toml"), "fitted", base.car, base.effects, base.values, chassis=base.chassis
    )
    known = knowledge_of(fitted)
    found = file_of_fitted(file, fitted, known)
    kept = {effect.name for effect in found.effects}
    own = {f"{e.name}.{p.name}" for e in found.effects for p in e.parameters}
    sds = {name: sd for name, sd in found.sd.items() if "." not in name or name in own}
    sds |= {name: float(np.hypot(sds[name], sd)) for name, sd in doubts if name in sds}
    signal = signal_noise(estimate_noise(runs))
    at = with_size(fitted.likelihood, fitted.point, 0.0)
    predictor, error = fitted.likelihood.predictor, at.linear.error
    values = parameter_vector(found.model)
    return Fit(
        model=found.model,
        estimates=identifiability.estimates_with_sds(found.effects, values, sds),
        labels=fitted.point.space.chart.labels,
        correlation=_correlation(known.covariance),
        converged=fitted.point.whole,
        misfit=misfit_of(predictor, error, signal),
        residuals=_residuals(predictor, error, signal),
        horizon=HORIZON,
        selected=tuple(step for step in fitted.selected if step.effect in kept),
        sections=found.sections,
        notes=describe_lost(fitted, runs),
    )


def _correlation(covariance: Array) -> Array:
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def _residuals(predictor: Predictor, error: Array, noise: Noise) -> Residuals:
    """Errors (W, D) as rows, those of means as large as single readings' would be."""
    layout, there = predictor.layout, predictor.padded.there > 0.0
    row, error = predictor.padded.row[there], error * np.sqrt(predictor.padded.merged)
    t = np.repeat(layout.t, there.sum(axis=1)) + layout.row_t[row]
    return Residuals(t, layout.group[row], error[there], np.array(noise.instruments))


class Row(NamedTuple):
    """One parameter."""

    value: float  # as identified
    start: float  # before
    sd: float | None  # standard error; None where it was not free
    unit: str  # of value and sd
    free: bool  # whether it was fitted
    identifiable: bool  # whether the data identify it
    manoeuvre: str = ""  # what would identify it; empty when identifiable or fixed


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
    """An identification."""

    method: str  # `ours`, `paper` or `cma-es`
    sessions: tuple[str, ...]  # fitted files
    held_out_of: str  # what the prediction errors were measured on, in words
    before: Car[float]  # the start values
    after: Car[float]  # the identified car
    rows: dict[str, Row]  # every parameter of the car, and its effects' free ones by `effect.name`
    held_out: tuple[HeldOut, ...]  # prediction errors
    excitation: Excitation  # of the fitted drives
    traces: tuple[list[Trace], list[Trace]]  # predictions of held-out drives, after and before
    fit: Fit | None = None  # of our method
    searches: tuple[SearchHistory, ...] = ()  # each start of a search
    seconds: float = 0.0  # how long the fit took
    notes: tuple[str, ...] = ()  # what a person should know
    truth: Car[float] | None = None  # the simulated car, where the sessions are simulated
    pulses: tuple[Pulse, ...] = ()  # phases of the servo's pulses, by drive
    ramps: tuple[Ramp, ...] = ()  # limits of the motor controller's setpoint, by drive
    log_jitters: tuple[LogJitter, ...] = ()  # how late slow logs stored the steering, by drive
    regimes: tuple[Regime, ...] = ()  # prediction errors after 1 s by lateral acceleration

    def __repr__(self) -> str:
        return f"<Outcome of {', '.join(self.sessions)}>"

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """Sums that the data fix."""
        return self.fit.combinations if self.fit else ()

    @property
    def free_rows(self) -> dict[str, Row]:
        """What was fitted."""
        return {n: r for n, r in self.rows.items() if r.free}

    @property
    def unidentified(self) -> dict[str, str]:
        """Free parameters that the data leave open, and what would identify them."""
        return {n: r.manoeuvre for n, r in self.free_rows.items() if not r.identifiable}


def encode_outcome(outcome: Outcome) -> dict[str, Any]:
    """The outcome as JSON values: schema `steerd.identify/1`; a number that is not known is NaN."""
    effects = [name for name in outcome.rows if "." in name]
    rows = {name: outcome.rows[name] for name in (*REPORTED, *effects)}
    return {
        "schema": SCHEMA,
        "parameters": {
            name: {key: getattr(row, key) for key in ("value", "sd", "unit", "identifiable")}
            for name, row in rows.items()
        },
        "combinations": [c.__dict__ for c in outcome.combinations],
        "held_out": {
            "horizons": [_encode_errors(*errors) for errors in outcome.held_out],
            "regimes": [regime._asdict() for regime in outcome.regimes],
        },
        "excitation": outcome.excitation._asdict(),
        "converged": None if outcome.fit is None else outcome.fit.converged,
        "misfit": None if outcome.fit is None else outcome.fit.misfit,
        "notes": list(outcome.notes),
    }  # fmt: skip


def _encode_errors(after: Prediction, before: Prediction) -> dict[str, float]:
    """The errors at one horizon, those before under other names."""
    _, *earlier = before._asdict().items()
    return after._asdict() | {f"{name}_before": value for name, value in earlier}


def make_rows(
    start: Model[float], after: Model[float], known: Mapping[str, Estimate]
) -> dict[str, Row]:
    """A row for each parameter of the car, and for those of effects that are free or left out."""
    gone = [effect for effect in start.effects if effect not in after.effects]
    effects, values = (*after.effects, *gone), (*after.values, *(e.nulls for e in gone))
    after = after._replace(effects=effects, values=values)
    own = {f"{e.name}.{p.name}": p for e in after.effects for p in e.parameters}
    units = {**{p.name: p.unit for p in PARAMETERS}, **{name: p.unit for name, p in own.items()}}
    before = {name: p.null for name, p in own.items()}
    before |= zip(parameter_names(start.effects), parameter_vector(start).tolist(), strict=True)
    rows = {}
    for (name, unit), value in zip(units.items(), parameter_vector(after).tolist(), strict=True):
        if e := known.get(name):
            sd = None if np.isnan(e.sd) else e.sd
            rows[name] = Row(value, before[name], sd, unit, True, e.identifiable, e.manoeuvre)
        elif "." not in name or value != before[name]:
            rows[name] = Row(value, before[name], None, unit, False, False)
    return rows


def searched_estimates(searches: Sequence[SearchHistory]) -> dict[str, Estimate]:
    """What the searches of the paper's methods found; the spread over starts stands for errors."""
    sound = [search for search in searches if not search.diverged]
    best = min(sound, key=lambda search: float(search.losses[-20:].mean())).final
    finals = np.array([search.final for search in sound])
    spread = finals.std(axis=0, ddof=1) if len(finals) > 1 else np.full(len(NAMES), nan)
    out = {}
    for name, value, sd in zip(NAMES, best.tolist(), spread.tolist(), strict=True):
        known = sd < identifiability.RELATIVE_MAX * value
        out[name] = Estimate(value, sd, known, "" if known else identifiability.MANOEUVRES[name])
    return out
