"""What an identification found: the car, how sure, and what is left of its windows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import CarFile
from steerd.car_model.model import Model
from steerd.car_model.native.windows import parameter_vector
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference.car_posterior import describe_lost, knowledge_of, taught_car
from steerd.sysid.inference.engine import HORIZON, Engine
from steerd.sysid.inference.identifiability import (
    Combination,
    Estimate,
    combinations,
    estimates,
    silent_estimates,
    taught_estimates,
)
from steerd.sysid.inference.noise import signal_noise
from steerd.sysid.inference.plain_car import Asked, PlainCar, covariance_of, misfit_of, silent_names
from steerd.sysid.inference.search import with_size
from steerd.sysid.inference.teaching import Step, Taught

Array = NDArray[np.float64]


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
    horizon = float(found.engine.layout.spans[:, 3].mean() * runs[0].h)
    return Fit(
        model=_moved(asked.model, known),
        estimates=known | silent_estimates(chart, silent_names(runs, asked.free)),
        labels=chart.labels,
        correlation=_correlation(covariance),
        converged=found.point.whole,
        misfit=found.misfit,
        residuals=_residuals(found.engine, error, np.array(found.noise.instruments)),
        horizon=horizon,
        combinations=combinations(chart, z, covariance, pace),
    )


def fit_of_taught(
    taught: Taught, base: Model[float], runs: Sequence[Run], doubts: Sequence[tuple[str, float]]
) -> Fit:
    """What a car says that windows of one second taught, disturbances known.

    Args:
        taught: the car.
        base: what it was taught from.
        runs: its drives.
        doubts: see `plain_car.covariance_of`.
    """
    file = CarFile(
        Path("taught.toml"), "taught", base.car, base.effects, base.values, chassis=base.chassis
    )
    found = taught_car(file, taught)
    kept = {effect.name for effect in found.effects}
    own = {f"{e.name}.{p.name}" for e in found.effects for p in e.parameters}
    sds = {name: sd for name, sd in found.sd.items() if "." not in name or name in own}
    sds |= {name: float(np.hypot(sds[name], sd)) for name, sd in doubts if name in sds}
    signal = signal_noise(estimate_noise(runs))
    at = with_size(taught.likelihood, taught.point, 0.0)
    engine, error = taught.likelihood.engine, at.linear.error
    return Fit(
        model=found.model,
        estimates=taught_estimates(found.effects, parameter_vector(found.model), sds),
        labels=taught.point.space.chart.labels,
        correlation=_correlation(knowledge_of(taught).covariance),
        converged=taught.point.whole,
        misfit=misfit_of(engine, error, signal),
        residuals=_residuals(engine, error, np.array(signal.instruments)),
        horizon=HORIZON,
        selected=tuple(step for step in taught.selected if step.effect in kept),
        sections=found.sections,
        notes=describe_lost(taught, runs),
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


def _residuals(engine: Engine, error: Array, signal: Array) -> Residuals:
    """Errors (W, D) as rows, those of means as large as single readings' would be."""
    layout, there = engine.layout, engine.padded.there > 0.0
    row = engine.padded.row[there]
    window = np.repeat(np.arange(len(there)), there.sum(axis=1))
    t = layout.t[window] + layout.row_t[row]
    return Residuals(t, layout.group[row], (error * np.sqrt(engine.padded.merged))[there], signal)
