"""What drives without a gap tell the diagnosis: how large noise is, and the base car once more.

`steerd.sysid.estimation.fit` weighs errors as instruments' noise; over whole drives what disturbs
the car on its way adds up and biases it. Here errors of one second are weighed by instruments and
disturbances both, the same measure by which the diagnosis judges, so that a healthy car has no gap
to it.
"""

# Why: docs/decisions/diagnosis.md#d50
# Why: docs/decisions/diagnosis.md#d52

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import BaseSelection
from steerd.car_model.model import Model
from steerd.sim_gap.engine import constants as c
from steerd.sim_gap.engine.base_fit import null_fit, open_engine
from steerd.sim_gap.engine.descent import Fitted, descend
from steerd.sim_gap.engine.engine import Engine
from steerd.sim_gap.engine.noise import (
    Noise,
    calibrated,
    learn_noise,
    noise_of_section,
    noise_section,
    noise_share,
    whitened,
)
from steerd.sim_gap.engine.residuals import ratios, robust_mean
from steerd.sim_gap.engine.space import nuisance_names, telling_effects
from steerd.sim_gap.engine.superset import Superset, make_superset
from steerd.sim_gap.verdict.candidates import blocks_of, gain_of, scored, singles
from steerd.sim_gap.verdict.decide import bounded
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise

_ROUNDS = 2
_REFITS = 4
_FAR = 1.0
"""A parameter so many prior standard deviations off is tried again about where it went ..."""
_AGAIN = 3
"""... so many times at most."""


def _learn(base: CarFile | Model[float], runs: Sequence[Run]) -> tuple[Noise, Fitted]:
    superset = make_superset(base, runs)
    engine = open_engine(superset, runs)
    nuisance, own = nuisance_names(superset, runs), _always(base, superset, runs)
    fitted, noise = null_fit(engine, nuisance, effects=own), None
    for _ in range(_ROUNDS):
        noise = learn_noise(engine, fitted, noise)
        engine = whitened(engine, fitted, noise)
        fitted = null_fit(engine, nuisance, fitted, own)
    noise = learn_noise(engine, fitted, noise)
    fitted = null_fit(whitened(engine, fitted, noise), nuisance, fitted, own)
    return _calibrated(engine, fitted, noise, runs), fitted


def _calibrated(engine: Engine, fitted: Fitted, noise: Noise, runs: Sequence[Run]) -> Noise:
    """Noise under which these drives leave just what the diagnosis takes for noise."""
    should = noise_share(engine, float(estimate_noise(runs)[2]))
    return calibrated(noise, robust_mean(ratios(fitted)), should)


def _always(base: CarFile | Model[float], superset: Superset, runs: Sequence[Run]) -> list[str]:
    """Manners that every car has, unless the base knows its own."""
    known = {effect.name for effect in base.effects}
    telling = telling_effects(superset, runs)
    return [
        e.name
        for e in superset.effects
        if e.on_every_car and e.name in telling and e.name not in known
    ]


def learn_healthy(base: CarFile | Model[float], runs: Sequence[Run]) -> Noise:
    """How large noise is, from drives without the gap (see `noise.noise_section` to keep it).

    What effects of the library would explain in them is no noise, whether or not the base has them.
    """
    noise, fitted = _learn(base, runs)
    if isinstance(base, Model):
        return noise
    told = noise_of_section(
        _with_own_effects(_moved(base, fitted, noise), runs, noise).sections["noise"]
    )
    return told or noise


def refine(base: CarFile, runs: Sequence[Run]) -> CarFile:
    """The base car as drives without a gap show it: parameters, errors, own effects, `[noise]`.

    An effect of the library that the healthy drives show clearly is the car's own manner and no
    gap; it becomes part of the base.

    Args:
        base: as identified; where its parameters end up is not tied to its standard errors.
        runs: drives without a gap.
    """
    noise, fitted = _learn(replace(base, sd={}), runs)
    for _ in range(_AGAIN):
        if np.abs(fitted.prior[: fitted.space.nuisance]).max() <= _FAR:
            break
        noise, fitted = _learn(replace(_moved(base, fitted, noise), sd={}), runs)
    return _with_own_effects(_moved(base, fitted, noise), runs, noise)


def _with_own_effects(base: CarFile, runs: Sequence[Run], noise: Noise) -> CarFile:
    """The base with what its healthy drives show beyond it, one effect after the other.

    The base's parameters are free about where they are: one that made up for an effect must be able
    to go back. So are the effects found so far, and noise is learnt anew with each.
    """
    superset = make_superset(replace(base, sd={}), runs)
    nuisance, own = nuisance_names(superset, runs), _always(base, superset, runs)
    engine = open_engine(superset, runs)
    engine = whitened(engine, null_fit(engine, nuisance, effects=own), noise)
    found = null_fit(engine, nuisance, effects=own)
    never = {e.name for e in base.effects} | {
        e.name for e in superset.effects if e.selectable_in_base is BaseSelection.NEVER
    }
    for _ in range(c.BUILT_IN):
        taken = never | set(found.space.effects)
        only = [name for name in telling_effects(superset, runs) if name not in taken]
        ranked = singles(engine, found, nuisance, only, most=_REFITS)
        if not ranked:
            break
        gain, se = gain_of(ranked[0], scored(engine, found), blocks_of(engine))
        if gain < max(c.BUILT_IN_GAIN, c.BUILT_IN_SE * bounded(gain, se)):
            break
        found = ranked[0].fitted
        for _ in range(_ROUNDS):
            noise = learn_noise(engine, found, noise)
            engine = whitened(engine, found, noise)
            found = descend(engine, found.space, found.z.copy(), found.x.copy())
        noise = _calibrated(engine, found, noise, runs)
    return _own(_moved(base, found, noise), found, superset)


def _own(base: CarFile, found: Fitted, superset: Superset) -> CarFile:
    """The base with the effects of a fit as its own."""
    chosen = [e for e in superset.effects if e.name in found.space.effects]
    p = found.parameters
    values = [tuple(float(v) for v in p[superset.places(e.name)]) for e in chosen]
    return replace(base, effects=(*base.effects, *chosen), values=(*base.values, *values))


def _moved(base: CarFile, fitted: Fitted, noise: Noise) -> CarFile:
    """The base with what a fit found."""
    chart, own = fitted.space.chart, fitted.space.nuisance
    p = dict(zip(chart.names, chart.parameters(fitted.z), strict=True))
    slopes = chart.slopes(fitted.z)
    sd = np.sqrt(np.einsum("pi,ij,pj->p", slopes, fitted.covariance, slopes))
    free = [chart.names.index(name) for name in chart.free[:own]]
    return replace(
        base,
        car=base.car._replace(**{chart.names[i]: float(p[chart.names[i]]) for i in free}),
        sd={**base.sd, **{chart.names[i]: float(sd[i]) for i in free}},
        sections={**base.sections, "noise": noise_section(noise)},
    )
