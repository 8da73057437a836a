"""The posterior of a car: what drives without a gap say of it, and how sure.

Errors of one second are weighed by instruments and disturbances both, the same measure by which a
diagnosis judges, so that a healthy car has no gap to it. The search begins under a discrepancy as
large as the start is wrong. Base parameters and the structure that every car has (tyres that level
off, a bent linkage) are free together under weak priors: their joint covariance is what a diagnosis
may move.
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
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.segments import thinned
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.estimation.chart import make_chart
from steerd.sysid.estimation.identifiability import BODY_OR_COG
from steerd.sysid.estimation.outcome import Step
from steerd.sysid.estimation.robust_covariance import Spread, inflate_each
from steerd.sysid.estimation.taught import NOTHING, Stated
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.engine import Engine, open_engine
from steerd.sysid.inference.hypotheses import Library, begin, explain
from steerd.sysid.inference.knowledge import (
    Knowledge,
    excess_by_regime,
    knowledge_section,
)
from steerd.sysid.inference.likelihood import SPUN, Likelihood, make_likelihood
from steerd.sysid.inference.noise import (
    Noise,
    calibrated,
    learn_noise,
    noise_of_sizes,
    noise_section,
    noise_share,
    usual_noise,
)
from steerd.sysid.inference.posterior import posterior_of
from steerd.sysid.inference.residuals import blocks_of, robust_mean
from steerd.sysid.inference.search import Point, minimise, stand, with_size
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
SLIDING, HARD, SLOW = 0.35, 6.0, 0.5
"""What a window that no car holds is said to be like [rad, m/s^2, m/s]."""
_NAMED = 3
CLEAR = 2.0
"""An effect within so many standard deviations of its null is left out of the car file."""
_LOUDER, _LOUDEST = 3.0, 80.0
"""Noise grows by this factor, and to so many times the usual at most, until ..."""
_FAR_OFF = 0.2
"""... a smaller share of the windows is bounded at the start."""
_STIFFER, _ENOUGH = 3.0, 60.0
"""Stiffness of a further start, and driving that is enough to choose between them [s]."""
_ROUNDS = 2
"""How often noise and base are learnt in turn."""


@dataclass(frozen=True, eq=False)
class Taught:
    """A car at its best on healthy drives.

    Attributes:
        likelihood: the windows under what was learnt to be random.
        point: the car there.
        noise: how large what is random is.
        nuisance: names of the car's free parameters.
        shares: of identification's weak priors, by parameter (see `ORDINARY`).
        selected: effects beyond those of every car that the drives show, the surest first.
    """

    likelihood: Likelihood
    point: Point
    noise: Noise
    nuisance: tuple[str, ...]
    shares: Mapping[str, float]
    selected: tuple[Step, ...] = ()

    @property
    def superset(self) -> Superset:
        """The car that was fitted."""
        return self.likelihood.engine.superset


def teach(base: CarFile | Model[float], runs: Sequence[Run], stated: Stated = NOTHING) -> Taught:
    """Fit car and noise in turn, under weak priors about the base's values.

    Args:
        base: where it starts.
        runs: drives without a gap.
        stated: what keeps the base's value.

    Raises:
        FloatingPointError: the base car's simulation diverges.
        ValueError: no window sees enough poses.
    """
    return _in_turn(_first(base, runs, stated), runs, _ROUNDS)


def choose_start(
    starts: Sequence[Model[float]], runs: Sequence[Run], stated: Stated = NOTHING
) -> Model[float]:
    """The start from which these drives are explained best; each also on stiffer tyres.

    From tyres that are too soft, hard bends lead to softer ones still instead of to ones that
    level off.

    Raises:
        FloatingPointError: the simulation diverges at every one.
        ValueError: no window sees enough poses.
    """
    some, found = thinned(runs, _ENOUGH), []
    models = [stiffer(start, factor, stated) for start in starts for factor in (1.0, _STIFFER)]
    for number, start in enumerate(models):
        try:
            found.append((_first(start, some, stated).point.cost, number))
        except (FloatingPointError, np.linalg.LinAlgError):
            continue
    if not found:
        raise FloatingPointError("the simulation diverges at every start")
    return models[min(found)[1]]


def stiffer(model: Model[float], factor: float, stated: Stated) -> Model[float]:
    """The model on tyres so many times as stiff, as far as nobody stated what they are."""
    car = model.car
    moved = {n: factor * getattr(car, n) for n in ("c_sf", "c_sr") if not stated.holds(n)}
    return model._replace(car=car._replace(**moved))


def _first(base: CarFile | Model[float], runs: Sequence[Run], stated: Stated) -> Taught:
    """The car at its best under noise as learnt about it, from noise that forgives the start.

    A window that is far off is bounded and pulls at nothing; were all so, the search would stay
    where it began.
    """
    base = replace(base, sd={}, sections={}) if isinstance(base, CarFile) else base
    superset = make_superset(base, runs)
    names = (*nuisance_names(superset, runs), *structure_names(superset, runs))
    nuisance = tuple(name for name in names if not stated.holds(name))
    shares = {**ORDINARY, **({"lf": MEASURED} if stated.wheelbase else {})}
    superset = replace(superset, knowledge=_weak(superset, nuisance, shares))
    engine, usual = open_engine(superset, runs), usual_noise(estimate_noise(runs))
    x = engine.readings.layout.guess.copy()
    noise = usual
    begun = _begin(engine, nuisance, x, noise)
    while _bounded(begun[1]) >= _FAR_OFF and noise.sizes[0] < _LOUDEST * usual.sizes[0]:
        noise = noise_of_sizes(_LOUDER * noise.sizes)
        begun = _begin(engine, nuisance, x, noise)
    taught = Taught(begun[0], minimise(*begun), noise, nuisance, shares)
    return taught if noise is usual else _again(taught, learn_noise(engine, taught.point, noise))


def _begin(
    engine: Engine, nuisance: tuple[str, ...], x: Array, noise: Noise
) -> tuple[Likelihood, Point]:
    """Windows under a noise, and the base at its prior."""
    likelihood = make_likelihood(engine, engine.superset.base, x, noise)
    return likelihood, begin(Library(likelihood, nuisance, (), known=False), (), (), x)


def _bounded(point: Point) -> float:
    """Share of the windows that are so far off that they pull at nothing."""
    return float((point.at.square >= SPUN * point.at.dof).mean())


def _again(taught: Taught, noise: Noise) -> Taught:
    """The car at its best under another noise, its responses taken where the car is now."""
    engine, old = taught.likelihood.engine, taught.point
    likelihood = make_likelihood(engine, old.parameters, old.x, noise)
    space = make_space(engine.superset, taught.nuisance)
    z = np.clip(space.chart.coordinates(old.parameters), space.low, space.high)
    begun = stand(likelihood, space, z, old.x, max(old.size, c.SIZE_SMALL))
    return replace(taught, likelihood=likelihood, point=minimise(likelihood, begun), noise=noise)


def _in_turn(taught: Taught, runs: Sequence[Run], rounds: int) -> Taught:
    """Noise and car, each given the other; then what regimes are allowed beyond the noise."""
    for _ in range(rounds):
        noise = learn_noise(taught.likelihood.engine, taught.point, taught.noise)
        taught = _again(taught, noise)
    noise = learn_noise(taught.likelihood.engine, taught.point, taught.noise)
    taught = _again(taught, noise)
    left, should = robust_mean(unweighed(taught)), noise_share_of(taught, runs)
    taught = _again(taught, calibrated(noise, left, should))
    excess = _excess(taught)
    weak = _weak(taught.superset, taught.nuisance, taught.shares)
    known = replace(weak, excess=tuple(e / excess[0] for e in excess))
    engine = replace(taught.likelihood.engine, superset=replace(taught.superset, knowledge=known))
    likelihood = replace(taught.likelihood, engine=engine)
    return _again(replace(taught, likelihood=likelihood), taught.noise)


def noise_share_of(taught: Taught, runs: Sequence[Run]) -> float:
    """What noise should leave of these drives' whitened error."""
    return noise_share(taught.likelihood.engine, float(estimate_noise(runs)[2]))


def ratios(taught: Taught) -> Array:
    """(W,) whitened squared errors per degree of freedom, no discrepancy allowed."""
    at = with_size(taught.likelihood, taught.point, 0.0).at
    return np.asarray(at.square / at.dof)


def unweighed(taught: Taught) -> Array:
    """(W,) the same without what regimes are allowed beyond the noise."""
    return ratios(taught) * taught.likelihood.engine.excess


def describe_lost(taught: Taught, runs: Sequence[Run]) -> tuple[str, ...]:
    """Where the car taught does not hold, and how it was driven there, in a sentence; often none.

    Args:
        taught: the car.
        runs: its drives.
    """
    engine, layout = taught.likelihood.engine, taught.likelihood.engine.readings.layout
    lost = ratios(taught) >= SPUN
    if not lost.any():
        return ()
    speed, slip = np.abs(taught.point.x[:, 3]), np.abs(taught.point.x[:, 5])
    why = [
        f"{text} in {int((lost & where).sum())}"
        for where, text in (
            (slip > SLIDING, f"sliding by more than {SLIDING:g} rad"),
            (engine.lateral > HARD, f"more than {HARD:g} m/s2 sideways"),
            (speed < SLOW, f"below {SLOW:g} m/s"),
        )
        if (lost & where).any()
    ]
    places = [f"{runs[layout.run[w]].name} {layout.t[w]:.1f} s" for w in np.flatnonzero(lost)]
    named = ", ".join(places[:_NAMED]) + (", ..." if len(places) > _NAMED else "")
    how = f": {', '.join(why)}" if why else ": driven like the others, so something acts there"
    return (f"the model does not hold {lost.sum()} of {len(lost)} windows of 1 s ({named}){how}",)


def _excess(taught: Taught, should: float = 1.0) -> tuple[float, ...]:
    """How much larger than noise errors are by lateral acceleration, whatever they are weighed by.

    Hard bends, in which the model misses most, shall not decide about values that gentle ones show.
    """
    return excess_by_regime(unweighed(taught) / should, taught.likelihood.engine.lateral)


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
    return {
        "noise": noise_section(taught.noise),
        "knowledge": knowledge_section(knowledge_of(taught)),
    }


def teach_with_limits(base: CarFile, runs: Sequence[Run], stated: Stated = NOTHING) -> Taught:
    """`teach`, once more with the limits and the play that the drives show, free like the rest."""
    taught = teach(base, runs, stated)
    shown = informative_effects(taught.superset, runs)
    free = {name.partition(".")[0] for name in taught.nuisance if "." in name}
    effects = tuple(
        e
        for e in taught.superset.effects
        if e.name in shown
        and e.name not in free
        and not stated.holds(e.name)
        and not (e.same_as and set(e.same_as) <= set(taught.nuisance))
        and e.selectable_in_base is not BaseSelection.NEVER
    )
    found = explain(Library(taught.likelihood, taught.nuisance, effects, known=False), c.BUILT_IN)
    if not found.best.effects:
        better = found.best.point
        return replace(taught, point=better) if better.cost < taught.point.cost else taught
    gain = found.best.posterior.evidence - found.null.posterior.evidence
    steps = tuple(Step(name, gain, 0.0) for name in found.best.effects)
    return replace(_with_effects(taught, found.best.point, runs), selected=steps)


def taught_car(base: CarFile, taught: Taught) -> CarFile:
    """The car file that says what was taught; effects that may as well be absent are left out."""
    known = knowledge_of(taught)
    z, kept = _without_small(taught, known.covariance)
    chart = taught.point.space.chart
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
    return with_sections(moved, known, taught.noise)


def _model_error(name: str, kept: Sequence[str]) -> float:
    """How many times a fit's standard error a parameter's is, among these effects."""
    if "marker_offset" in kept and name in BODY_OR_COG:
        return MODEL_ERROR_MOVED
    return MODEL_ERROR.get(name, 1.0)


def with_sections(base: CarFile, known: Knowledge, noise: Noise) -> CarFile:
    """The base with what its drives taught beyond its values."""
    tables = {"noise": noise_section(noise), "knowledge": knowledge_section(known)}
    return replace(base, sections={**base.sections, **tables})


def _structures(taught: Taught) -> list[str]:
    """Names of the effects that were free, each once."""
    return list(dict.fromkeys(n.partition(".")[0] for n in taught.nuisance if "." in n))


def _without_small(taught: Taught, covariance: Array) -> tuple[Array, list[str]]:
    """Coordinates with every effect at its null that is not clearly elsewhere, and those kept.

    The smallest goes first; what moves with it moves to where it lies given that null.
    """
    space, superset = taught.point.space, taught.superset
    labels, z = list(space.chart.free), taught.point.z.copy()
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
        pull = np.linalg.solve(covariance[np.ix_(gone, gone)], held - taught.point.z[gone])
        z[rest] = taught.point.z[rest] + covariance[np.ix_(rest, gone)] @ pull
        z[gone] = held
    return np.clip(z, space.low, space.high), list(names)


def _place(labels: Sequence[str], i: int) -> int:
    """Which of its effect's parameters a coordinate is."""
    effect = labels[i].partition(".")[0]
    return sum(name.startswith(f"{effect}.") for name in labels[:i])


def knowledge_of(taught: Taught) -> Knowledge:
    """Joint covariance and discrepancy of a car.

    Scores that vary more from block to block than noise makes them widen the errors (White, 1982):
    that is how a model that is wrong a little everywhere shows. The covariance is positive
    definite: a direction that the drives do not show keeps its prior's width.
    """
    likelihood, point = taught.likelihood, taught.point
    blocks, at = blocks_of(likelihood.engine), point.at
    pulls = at.weight[:, None] * at.g
    sums = np.zeros((int(blocks.max()) + 1, pulls.shape[1]))
    np.add.at(sums, blocks, pulls)
    sums -= sums.mean(axis=0)
    inverse = posterior_of(point, 1.0).covariance
    covariance = inflate_each(inverse, Spread(sums.T @ sums, float(len(sums))))
    excess = _excess(taught, robust_mean(ratios(taught)))
    p, names = point.parameters, taught.superset.kernels.names
    values = tuple(float(p[names.index(name)]) for name in taught.nuisance)
    return Knowledge(taught.nuisance, covariance, excess, values)


def _with_effects(taught: Taught, point: Point, runs: Sequence[Run]) -> Taught:
    """What was taught, with the effects of a hypothesis free about its values."""
    old, start = taught.superset, point.parameters
    centre, nulls = old.base.copy(), dict(old.nulls)
    for name in point.space.effects:
        centre[old.places(name)] = start[old.places(name)]
        nulls[name] = tuple(start[old.places(name)].tolist())
    own = tuple(n for n in old.kernels.names if n.partition(".")[0] in point.space.effects)
    nuisance = (*taught.nuisance, *own)
    superset = replace(old, base=centre, nulls=nulls)
    superset = replace(superset, knowledge=_weak(superset, nuisance, taught.shares))
    engine = replace(taught.likelihood.engine, superset=superset)
    likelihood = replace(taught.likelihood, engine=engine)
    grown = replace(taught, likelihood=likelihood, point=point, nuisance=nuisance)
    return _in_turn(grown, runs, 0)
