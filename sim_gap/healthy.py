"""What drives without a gap tell the diagnosis: how large noise is, and the base car once more.

`sysid.fit` weighs errors as instruments' noise; over whole drives what disturbs the car on its way
adds up and biases it. Here errors of one second are weighed by instruments and disturbances both,
the same measure by which the diagnosis judges, so that a healthy car has no gap to it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from car_model.car_file import CarFile
from car_model.model import Model
from sim_gap import constants as c
from sim_gap.candidates import blocks_of, gain_of, scored, singles
from sim_gap.decide import bounded
from sim_gap.descent import Fitted
from sim_gap.noise import Noise, calibrated, learn_noise, noise_of_section, noise_section, whitened
from sim_gap.opening import null_fit, open_engine
from sim_gap.residuals import ratios, robust_mean, settled
from sim_gap.space import nuisance_names, telling_effects
from sim_gap.superset import make_superset
from sysid.dataset import Run

_ROUNDS = 2
_REFITS = 4
NEVER_OWN = frozenset({"grip_patch", "grip_drift", "battery_sag", "mass"})
"""Effects of a place or a day, and what no pose can tell: no manner of a car."""
_FAR = 2.5
"""A parameter so many prior standard deviations off is tried again about where it went."""


def _learn(base: CarFile | Model[float], runs: Sequence[Run]) -> tuple[Noise, Fitted]:
    superset = make_superset(base, runs)
    engine = open_engine(superset, runs)
    nuisance = nuisance_names(superset, runs)
    fitted, noise = null_fit(engine, nuisance), None
    for _ in range(_ROUNDS):
        noise = learn_noise(engine, fitted, noise)
        engine = whitened(engine, fitted, noise)
        fitted = null_fit(engine, nuisance, fitted)
    noise = learn_noise(engine, fitted, noise)
    fitted = null_fit(whitened(engine, fitted, noise), nuisance, fitted)
    return calibrated(noise, robust_mean(ratios(fitted))), fitted


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
    if np.abs(fitted.prior).max() > _FAR:
        noise, fitted = _learn(replace(_moved(base, fitted, noise), sd={}), runs)
    return _with_own_effects(_moved(base, fitted, noise), runs, noise)


def _with_own_effects(base: CarFile, runs: Sequence[Run], noise: Noise) -> CarFile:
    """The base with what its healthy drives show beyond it, one effect after the other."""
    for _ in range(c.BUILT_IN):
        superset = make_superset(base, runs)
        nuisance = nuisance_names(superset, runs)
        engine = open_engine(superset, runs)
        engine = whitened(engine, null_fit(engine, nuisance), noise)
        null = null_fit(engine, nuisance)
        taken = {e.name for e in base.effects} | NEVER_OWN
        only = [name for name in telling_effects(superset, runs) if name not in taken]
        ranked = singles(engine, null, nuisance, only, most=_REFITS)
        if not ranked:
            break
        gain, se = gain_of(ranked[0], scored(engine, null), blocks_of(engine))
        if gain < c.BUILT_IN_GAIN or gain < c.GAIN_SE * bounded(gain, se):
            break
        found = ranked[0].fitted
        noise = learn_noise(engine, found, noise)
        left = settled(whitened(engine, found, noise), found.space, found.z, found.x)
        noise = calibrated(noise, robust_mean(ratios(left)))
        moved = _moved(base, found, noise)
        name = ranked[0].name
        values = tuple(float(v) for v in found.parameters[superset.places(name)])
        effect = next(e for e in superset.effects if e.name == name)
        base = replace(moved, effects=(*base.effects, effect), values=(*base.values, values))
    return base


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
