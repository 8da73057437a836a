"""What drives without a gap teach: the base car with all that every car has, and how sure of it.

`steerd.sysid.estimation.fit` weighs errors as instruments' noise; over whole drives what disturbs
the car on its way adds up and biases it. Here errors of one second are weighed by instruments and
disturbances both, the same measure by which the diagnosis judges, so that a healthy car has no gap
to it. Base parameters and the structure that every car has (tyres that level off, a bent linkage)
are free together under weak priors: their joint covariance is what the diagnosis may move.
"""

# Why: docs/decisions/diagnosis.md#d50
# Why: docs/decisions/diagnosis.md#d52
# Why: docs/decisions/identification.md#d94
# Why: docs/decisions/identification.md#d100

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import BaseSelection
from steerd.car_model.model import Model
from steerd.sim_gap.verdict.candidates import (
    Score,
    better_base,
    blocks_of,
    gain_of,
    refit_all,
    scored,
)
from steerd.sim_gap.verdict.screen import screen
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.estimation.chart import make_chart
from steerd.sysid.estimation.identifiability import BODY_OR_COG
from steerd.sysid.estimation.outcome import Step
from steerd.sysid.estimation.robust_covariance import Spread, inflate_each
from steerd.sysid.estimation.taught import NOTHING, Stated
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.base_fit import null_fit, open_engine
from steerd.sysid.inference.dead_times import try_other_dead_times
from steerd.sysid.inference.engine import Engine, Reduced
from steerd.sysid.inference.knowledge import (
    EDGES,
    Knowledge,
    excess_by_regime,
    knowledge_section,
    numbers_of,
)
from steerd.sysid.inference.levenberg_marquardt import Fitted, curvature, minimise
from steerd.sysid.inference.noise import (
    Noise,
    calibrated,
    learn_noise,
    noise_section,
    noise_share,
    whitened,
)
from steerd.sysid.inference.residuals import ratios, robust_mean
from steerd.sysid.inference.space import informative_effects, make_space, nuisance_names
from steerd.sysid.inference.superset import Superset, make_superset

Array = NDArray[np.float64]

ORDINARY: dict[str, float] = {
    "lf": 0.075, "lr": 0.1, "steer_gain": 0.33, "inertia_z": 0.4, "c_sf": 0.7, "c_sr": 0.7,
    "marker_offset.forward": 0.25, "accel_max": 0.2, "decel_max": 0.2,
    "lateral_load_transfer.k": 0.3,
}  # fmt: skip
"""Share of identification's weak priors that is left when a base is taught.

A car comes with a wheelbase (the coordinate of `lf`) known to 15 mm, a centre of gravity known
to 2 cm, markers placed to 5 mm and a gain known to 0.1. A tyre's friction falls by a few tenths at
most where its load doubles, which makes `k` 0.15 on a car as low as these; a larger one stands in
for tyres that slide, and says too much of bends harder than the drives'.
"""
FIRST: dict[str, float] = {**ORDINARY, "lf": 0.015}
"""The same while noise is not known yet, with the wheelbase near where it was.

Larger cars that steer more, slide more and have more inertia drive almost alike. Weighed by a first
guess of the noise, what the model misses would decide about that scale, and the search would not
come back: it ends 45 nats above the optimum on a car whose model is right.
"""
MEASURED = 5e-4
"""The wheelbase's share where it was measured: it stays within 0.1 mm of what was stated."""
MODEL_ERROR: dict[str, float] = {
    "lf": 1.6, "lr": 1.6, "c_sf": 4.0, "c_sr": 2.3, "c_x": 2.0, "inertia_z": 4.5, "steer_gain": 2.0,
    "speed_gain": 2.5,
}  # fmt: skip
"""Standard errors are so many times those of the fit.

What the model misses is the same in every drive, so no spread between drives shows it: a servo of
second order looks like inertia, a foreign tyre like a stiff one. Root mean square of the errors in
the fit's standard errors on four cars each of three foreign simulators (seeds 9001 to 9004), the
wheelbase measured; of two further `own` cars for the lengths; of what has no true value there, as
for the others at first. `speed_gain` has that of the twelve cars of the sixth sealed set (1.7 and
1.1 on two simulators, 3.8 on the one with sprung wheels). `[knowledge]` keeps the fit's: a later
drive of the same car misses the same.
"""
MODEL_ERROR_MOVED = 4.0
"""The same for `BODY_OR_COG` where the mocap body's place on the car is learnt as well.

Drives fix where the body is between the axles to a millimetre; only the finer points of the model
say where the centre of gravity is. On 30 cars of three foreign simulators, no body misplaced, 4
were taken for one with a body 13 to 31 mm off; both axles' lengths were off by as much, 20 mm in
the root mean square at standard errors of 5. Of the other 26 no length was off by more than 5 mm.
"""
CLEAR = 2.0
"""An effect within so many standard deviations of its null is left out of the car file."""
_ROUNDS = 2
"""How often noise and base are learnt in turn."""


@dataclass(frozen=True, eq=False)
class Taught:
    """A base at its best on healthy drives.

    Attributes:
        superset: the car that was fitted.
        engine: the windows, whitened by `noise`.
        fitted: the base there.
        noise: how large what is random is.
        nuisance: names of the base's free parameters.
        shares: of identification's weak priors, by parameter (see `ORDINARY`).
        selected: effects beyond those of every car that the drives show, the surest first.
    """

    superset: Superset
    engine: Engine
    fitted: Fitted
    noise: Noise
    nuisance: tuple[str, ...]
    shares: Mapping[str, float]
    selected: tuple[Step, ...] = ()


def teach(base: CarFile | Model[float], runs: Sequence[Run], stated: Stated = NOTHING) -> Taught:
    """Fit base and noise in turn, under weak priors about the base's values.

    Args:
        base: where it starts.
        runs: drives without a gap.
        stated: what keeps the base's value.

    Raises:
        FloatingPointError: the base car's simulation diverges.
        ValueError: no window sees enough poses.
    """
    base = replace(base, sd={}, sections={}) if isinstance(base, CarFile) else base
    superset = make_superset(base, runs)
    names = (*nuisance_names(superset, runs), *structure_names(superset, runs))
    nuisance = tuple(name for name in names if not stated.holds(name))
    length = {"lf": MEASURED} if stated.wheelbase else {}
    superset = replace(superset, knowledge=_weak(superset, nuisance, {**FIRST, **length}))
    engine = open_engine(superset, runs)
    shares = {**ORDINARY, **length}
    return _in_turn(engine, null_fit(engine, nuisance), None, (nuisance, shares), runs)


def _in_turn(
    engine: Engine,
    fitted: Fitted,
    noise: Noise | None,
    free: tuple[tuple[str, ...], Mapping[str, float]],
    runs: Sequence[Run],
) -> Taught:
    """Noise and base, each given the other; `free` are names and their priors' shares."""
    nuisance, shares = free
    for _ in range(_ROUNDS if noise is None else 1):
        noise = learn_noise(engine, fitted, noise)
        engine = whitened(engine, fitted, noise)
        fitted = try_other_dead_times(engine, null_fit(engine, nuisance, fitted))
    noise = _calibrated(engine, fitted, learn_noise(engine, fitted, noise), runs)
    engine = whitened(engine, fitted, noise)
    fitted = null_fit(engine, nuisance, fitted)
    excess = _excess(engine, fitted)
    known = replace(
        _weak(engine.superset, nuisance, shares), excess=tuple(e / excess[0] for e in excess)
    )
    superset = replace(engine.superset, knowledge=known)
    engine = whitened(replace(engine, superset=superset), fitted, noise)
    return Taught(superset, engine, null_fit(engine, nuisance, fitted), noise, nuisance, shares)


def _excess(engine: Engine, fitted: Fitted, should: float = 1.0) -> tuple[float, ...]:
    """How much larger than noise errors are by lateral acceleration, whatever they are weighed by.

    Hard bends, in which the model misses most, shall not decide about values that gentle ones show.
    """
    return excess_by_regime(_unweighed(engine, fitted) / should, engine.lateral)


def _unweighed(engine: Engine, fitted: Fitted) -> Array:
    """(W,) squared errors over noise, without what regimes are allowed beyond it."""
    known = engine.superset.knowledge
    assert known is not None  # noqa: S101 -- every teacher's superset has weak knowledge
    allowed: Array = np.array(known.excess)[np.digitize(engine.lateral, EDGES)]
    return ratios(fitted) * allowed


def structure_names(superset: Superset, runs: Sequence[Run]) -> tuple[str, ...]:
    """Parameters of the effects that no real car is without, as far as such drives show them."""
    shown = informative_effects(superset, runs)
    return tuple(
        f"{effect.name}.{parameter.name}"
        for effect in superset.effects
        if effect.on_every_car and effect.name in shown
        for parameter in effect.parameters
    )


def _weak(superset: Superset, names: Sequence[str], shares: Mapping[str, float]) -> Knowledge:
    """Knowing next to nothing: ordinary spreads of cars of this class."""
    chart = make_chart(superset.effects, superset.base, names)
    own = [shares.get(name, 1.0) for name in chart.free]
    return Knowledge(tuple(names), np.diag(np.square(own * chart.spread)))


def _calibrated(engine: Engine, fitted: Fitted, noise: Noise, runs: Sequence[Run]) -> Noise:
    """Noise under which these drives leave just what the diagnosis takes for noise."""
    should = noise_share(engine, float(estimate_noise(runs)[2]))
    return calibrated(noise, robust_mean(_unweighed(engine, fitted)), should)


def learn_healthy(base: CarFile | Model[float], runs: Sequence[Run]) -> Noise:
    """How large noise is, from drives without the gap (see `noise.noise_section` to keep it)."""
    return teach(base, runs).noise


def refine(base: CarFile, runs: Sequence[Run], stated: Stated = NOTHING) -> CarFile:
    """The base car as drives without a gap show it: values, errors, `[noise]` and `[knowledge]`.

    Args:
        base: as identified; only its values are a start.
        runs: drives without a gap.
        stated: what keeps the base's value.

    Raises:
        FloatingPointError: the base car's simulation diverges.
        ValueError: no window sees enough poses.
    """
    return taught_car(base, teach_with_limits(base, runs, stated))


def learn_sections(base: CarFile, runs: Sequence[Run]) -> dict[str, dict[str, Any]]:
    """`[noise]` and `[knowledge]` for a car file whose numbers stay as they are.

    Raises:
        FloatingPointError: the base car's simulation diverges.
        ValueError: no window sees enough poses.
    """
    taught = teach_with_limits(base, runs)
    sections = with_sections(base, base, knowledge_of(taught), taught.noise).sections
    return {name: dict(sections[name]) for name in ("noise", "knowledge")}


def teach_with_limits(base: CarFile, runs: Sequence[Run], stated: Stated = NOTHING) -> Taught:
    """`teach`, once more with the limits and the play that the drives show, free like the rest."""
    taught = teach(base, runs, stated)
    shown = _shown(taught, runs, stated)
    better = better_base(taught.engine, taught.fitted, shown, c.BUILT_IN_GAIN)
    if better is not None:
        taught = replace(taught, fitted=better)
        shown = _shown(taught, runs, stated)
    if not shown:
        return taught
    null, blocks = scored(taught.engine, taught.fitted), blocks_of(taught.engine)
    steps = tuple(Step(score.name, *gain_of(score, null, blocks)) for score in shown)
    values = {
        score.name: tuple(score.fitted.parameters[taught.superset.places(score.name)].tolist())
        for score in shown
    }
    return replace(_with_effects(taught, values, runs), selected=steps)


def taught_car(base: CarFile, taught: Taught) -> CarFile:
    """The car file that says what was taught; effects that may as well be absent are left out."""
    known = knowledge_of(taught)
    z, kept = _without_small(taught, known.covariance)
    chart = taught.fitted.space.chart
    p, slopes = chart.parameters(z), chart.slopes(z)
    spread = np.sqrt(np.einsum("pi,ij,pj->p", slopes, known.covariance, slopes))
    free = {name: chart.names.index(name) for name in taught.nuisance}
    car = {name: float(p[i]) for name, i in free.items() if "." not in name}
    own = dict(zip((e.name for e in base.effects), base.values, strict=True))
    own = {name: values for name, values in own.items() if name not in _structures(taught)}
    own |= {name: tuple(p[taught.superset.places(name)].tolist()) for name in kept}
    chosen = [e for e in taught.superset.effects if e.name in own]
    sd = {name: float(spread[i]) * _model_error(name, kept) for name, i in free.items()}
    moved = replace(
        base,
        car=base.car._replace(**car),
        effects=tuple(chosen),
        values=tuple(own[e.name] for e in chosen),
        sd={**base.sd, **{n: v for n, v in sd.items() if "." not in n or n.split(".")[0] in own}},
    )
    return with_sections(moved, moved, known, taught.noise)


def _model_error(name: str, kept: Sequence[str]) -> float:
    """How many times a fit's standard error a parameter's is, among these effects."""
    if "marker_offset" in kept and name in BODY_OR_COG:
        return MODEL_ERROR_MOVED
    return MODEL_ERROR.get(name, 1.0)


def with_sections(base: CarFile, file: CarFile, known: Knowledge, noise: Noise) -> CarFile:
    """The base with `[noise]` and `[knowledge]`, as they stand beside the numbers of `file`."""
    section = knowledge_section(replace(known, of=numbers_of(file)))
    return replace(
        base, sections={**base.sections, "noise": noise_section(noise), "knowledge": section}
    )


def _structures(taught: Taught) -> list[str]:
    """Names of the effects that were free, each once."""
    return list(dict.fromkeys(n.partition(".")[0] for n in taught.nuisance if "." in n))


def _without_small(taught: Taught, covariance: Array) -> tuple[Array, list[str]]:
    """Coordinates with every effect at its null that is not clearly elsewhere, and those kept.

    The smallest goes first; what moves with it moves to where it lies given that null.
    """
    space, superset = taught.fitted.space, taught.superset
    labels, z = list(space.chart.free), taught.fitted.z.copy()
    nulls = {e.name: e.nulls for e in superset.effects}
    names = {name: [i for i, n in enumerate(labels) if n.startswith(f"{name}.")]
             for name in _structures(taught)}  # fmt: skip
    gone: list[int] = []
    while names:
        sizes = {}
        for name, mine in names.items():
            away = z[mine] - np.array(nulls[name])
            sizes[name] = float(away @ np.linalg.solve(covariance[np.ix_(mine, mine)], away))
            sizes[name] /= len(mine)
        least = min(sizes, key=lambda name: sizes[name])
        if sizes[least] > CLEAR**2:
            break
        gone += names.pop(least)
        held = np.array([nulls[labels[i].partition(".")[0]][_place(labels, i)] for i in gone])
        rest = [i for i in range(len(z)) if i not in gone]
        pull = np.linalg.solve(covariance[np.ix_(gone, gone)], held - taught.fitted.z[gone])
        z[rest] = taught.fitted.z[rest] + covariance[np.ix_(rest, gone)] @ pull
        z[gone] = held
    return np.clip(z, space.low, space.high), list(names)


def _place(labels: Sequence[str], i: int) -> int:
    """Which of its effect's parameters a coordinate is."""
    effect = labels[i].partition(".")[0]
    return sum(name.startswith(f"{effect}.") for name in labels[:i])


def knowledge_of(taught: Taught) -> Knowledge:
    """Joint covariance and discrepancy of a base.

    Scores that vary more from block to block than noise makes them widen the errors (White, 1982):
    that is how a model that is wrong a little everywhere shows.
    """
    engine, fitted = taught.engine, taught.fitted
    blocks, at = blocks_of(engine), _with_secants(taught)
    inverse = np.asarray(np.linalg.inv(curvature(fitted.space, at)))
    pulls = at.weight[:, None] * at.g
    sums = np.zeros((int(blocks.max()) + 1, pulls.shape[1]))
    np.add.at(sums, blocks, pulls)
    sums -= sums.mean(axis=0)
    covariance = inflate_each(inverse, Spread(sums.T @ sums, float(len(sums))))
    excess = _excess(engine, fitted, robust_mean(ratios(fitted)))
    p, names = fitted.parameters, taught.superset.kernels.names
    values = tuple(float(p[names.index(name)]) for name in taught.nuisance)
    return Knowledge(taught.nuisance, covariance, excess, values)


def _with_secants(taught: Taught) -> Reduced:
    """Losses about the best point, dead times differenced over a step each way.

    A servo at its slew limit starts on the step in which a command arrives, whatever the fraction:
    the likelihood has steps in the delays, and its slope at one says too much.
    """
    engine, fitted, space = taught.engine, taught.fitted, taught.fitted.space
    linear = engine.linear(space, fitted.z, fitted.x)
    by_z, step = linear.by_z.copy(), engine.readings.layout.h / engine.substeps
    for i, name in enumerate(space.chart.free):
        if not name.endswith("_delay"):
            continue
        ends = [np.clip(fitted.z[i] + s, space.low[i], space.high[i]) for s in (-step, step)]
        errors = []
        for end in ends:
            z = fitted.z.copy()
            z[i] = end
            errors.append(engine.missed(space, z, fitted.x)[0])
        by_z[:, :, i] = (errors[0] - errors[1]) / (ends[1] - ends[0])
    tangent = engine.tangent(linear._replace(by_z=by_z))
    return engine.reduce_by(tangent, linear.error, fitted.x)._replace(limit=fitted.at.limit)


def _shown(taught: Taught, runs: Sequence[Run], stated: Stated) -> list[Score]:
    """Further effects that healthy drives show: this car has them, so later they are no gap."""
    engine, null, nuisance = taught.engine, taught.fitted, taught.nuisance
    shown = informative_effects(taught.superset, runs)
    free = {name.partition(".")[0] for name in nuisance if "." in name}
    only = [
        e.name
        for e in taught.superset.effects
        if e.name in shown
        and e.name not in free
        and not stated.holds(e.name)
        and e.selectable_in_base is not BaseSelection.NEVER
    ]
    promises = [p for p in screen(engine, null, nuisance, only) if p.gain > c.BUILT_IN_GAIN]
    ranked = refit_all(engine, null, nuisance, promises)
    likely = sorted(ranked, key=lambda score: score.fitted.cost)[: c.BUILT_IN]
    return [score for score in likely if null.cost - score.fitted.cost > c.BUILT_IN_GAIN]


def _with_effects(
    taught: Taught, more: dict[str, tuple[float, ...]], runs: Sequence[Run]
) -> Taught:
    """What was taught, with more effects free about these values."""
    old, before = taught.superset, taught.fitted
    centre, start = old.base.copy(), before.parameters.copy()
    for name, values in more.items():
        centre[old.places(name)] = start[old.places(name)] = values
    own = tuple(name for name in old.kernels.names if name.partition(".")[0] in more)
    nuisance = (*taught.nuisance, *own)
    superset = replace(old, base=centre, nulls={**old.nulls, **more})
    superset = replace(superset, knowledge=_weak(superset, nuisance, taught.shares))
    engine, space = replace(taught.engine, superset=superset), make_space(superset, nuisance)
    z = np.clip(space.chart.coordinates(start), space.low, space.high)
    fitted = minimise(engine, space, z, before.x.copy())
    return _in_turn(engine, fitted, taught.noise, (nuisance, taught.shares), runs)
