"""The whole diagnosis: where the gap lies, which effect causes it, how far adding it shrinks it.

`diagnose` is a pure function of the drives and the base car (but for an optional callback that is
handed the prediction before the reserved drives are looked at).
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import Effect
from steerd.car_model.model import Model
from steerd.sim_gap.verdict.evidence import Cause, Verdict, judge_case
from steerd.sim_gap.verdict.next_manoeuvre import Manoeuvre, next_manoeuvre
from steerd.sim_gap.verdict.residual_shape import Shape, Timeline, shape_of, timeline_of
from steerd.sim_gap.verdict.shrinkage import Horizon, Shrinkage, cross_check, measure, predict
from steerd.sim_gap.verdict.where import Where, locate
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import AugmentedCar, augment
from steerd.sysid.inference.car_fit import fit_car
from steerd.sysid.inference.car_posterior import refine
from steerd.sysid.inference.hypotheses import Findings, Hypothesis, Library, explain
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.noise import (
    Noise,
    learn_noise,
    noise_floor,
    noise_of_section,
    noisier_of,
    usual_noise,
)
from steerd.sysid.inference.predictor import Predictor, make_predictor
from steerd.sysid.inference.residuals import Gap, blocks_of, folds_of, gap_of, settled, spun_windows
from steerd.sysid.inference.search import Point
from steerd.sysid.inference.space import Asked, informative_effects, make_space, nuisance_names

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Options:
    """How to diagnose.

    Attributes:
        held_out: drives that are only opened after the prediction is written; or how to get them,
            which is then called after it.
        healthy: drives of the base car without the gap; they show how large noise is, and
            refine a base that is a car file (see `car_posterior.refine`).
        noise: how large noise is, if it is known (also read from the car file's `[noise]`).
        only: effects to look at; None takes the library.
        without: effects to leave out.
        pairs: whether two causes together are tried.
        horizons: whether the gap is looked at over other horizons too.
        progress: called with a stage's name and the share done.
        written: called with the prediction (JSON) before the reserved drives are opened.
    """

    held_out: Sequence[Run] | Callable[[], Sequence[Run]] = ()
    healthy: Sequence[Run] = ()
    noise: Noise | None = None
    only: Sequence[str] | None = None
    without: Sequence[str] = ()
    pairs: bool = True
    horizons: bool = True
    progress: Callable[[str, float], None] = lambda stage, share: None
    written: Callable[[str], None] = lambda prediction: None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found.

    Attributes:
        verdict: `none`, `explained`, `partial`, `unexplained` or `unjudged`.
        before: the gap of the base; `after` with the explanation.
        where: where the base's error lies.
        causes: named effects, the verdict's first.
        something_else: posterior probability that no effect of the library is a cause.
        candidates: (effects, probability, gain over the base alone [nats]) of each hypothesis.
        shrinkage: predicted and, with reserved drives, measured.
        next_manoeuvre: what to drive to distinguish ambiguous causes, if there are any.
        shape: what is left.
        moved: z-scores of base parameters that moved within their uncertainty.
        noise: what was taken as random; `noise_known` if not from these drives.
        notes: what a reader should know about how this was done.
        values: all effects' parameters of the explanation, by effect, for a car file.
        timeline: the gap window by window.
        horizons: the gap over other horizons.
    """

    verdict: str
    before: Gap
    after: Gap
    where: Where
    causes: tuple[Cause, ...]
    something_else: float
    candidates: tuple[tuple[str, float, float], ...]
    shrinkage: Shrinkage
    next_manoeuvre: Manoeuvre | None
    shape: Shape
    moved: dict[str, float]
    noise: Noise
    noise_known: bool
    notes: tuple[str, ...]
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    timeline: Timeline | None = None
    horizons: tuple[Horizon, ...] = ()

    def __repr__(self) -> str:
        names = ", ".join(cause.effect for cause in self.causes)
        return f"<Diagnosis: {self.verdict}{names and f', {names}'}>"


def _known_noise(base: CarFile | Model[float], options: Options) -> Noise | None:
    if options.noise is not None:
        return options.noise
    if options.healthy and not isinstance(base, CarFile):
        return fit_car(Asked(base), options.healthy).noise
    return noise_of_section(base.sections.get("noise", {})) if isinstance(base, CarFile) else None


@dataclass(frozen=True, eq=False)
class _Case:
    """What the stages share.

    Attributes:
        library: windows, free parameters of the base, effects.
        likelihood: the windows, their responses taken about the likeliest hypothesis.
        noise: what was taken as random; `known` if not from these drives.
        floor: what noise leaves of the whitened error.
        found: every hypothesis; `verdict` of them.
        blocks: (W,) windows that follow each other.
    """

    library: Library
    likelihood: Likelihood
    noise: Noise
    known: bool
    floor: float
    found: Findings
    verdict: Verdict
    blocks: NDArray[np.int64]

    @property
    def predictor(self) -> Predictor:
        """The windows."""
        return self.likelihood.predictor

    def settle(self, hypothesis: Hypothesis) -> Point:
        """A hypothesis without any discrepancy allowed."""
        point = hypothesis.point
        return settled(self.likelihood, point.space, point.z, point.x)


def diagnose(
    runs: Sequence[Run], base: CarFile | Model[float], options: Options | None = None
) -> Diagnosis:
    """Diagnose the gap between a base car and drives.

    Args:
        runs: the drives to explain; one is split into blocks, several are left out whole.
        base: the car as identified; with standard errors the base's own uncertainty is known,
            without them ordinary ones are assumed (and said).
        options: see `Options`.

    Raises:
        DataError: the drives are not fit for it.
        ValueError: runs on different grids, or an unknown effect.
        FloatingPointError: the base car's simulation diverges.
    """
    options = options or Options()
    if options.healthy and isinstance(base, CarFile):
        base = refine(base, options.healthy)
    augmented = augment(base, runs)
    only = _chosen(augmented, runs, options)
    options.progress("base", 0.05)
    case = _search(augmented, runs, base, only, options)
    found = _conclude(case, options, [run.name for run in runs], _base_notes(augmented, base))
    if not options.horizons:
        return found
    return _with_horizons(case, found, runs)


def _chosen(augmented: AugmentedCar, runs: Sequence[Run], options: Options) -> tuple[Effect, ...]:
    """Effects that may be a cause.

    Raises:
        ValueError: an option names none.
    """
    names = [e.name for e in augmented.effects]
    unknown = [n for n in (*(options.only or ()), *options.without) if n not in names]
    if unknown:
        raise ValueError(f"no effect {unknown[0]!r}; `steerd effects` lists them")
    only = options.only or informative_effects(augmented, runs)
    return tuple(e for e in augmented.effects if e.name in only and e.name not in options.without)


def _search(
    augmented: AugmentedCar,
    runs: Sequence[Run],
    base: CarFile | Model[float],
    effects: tuple[Effect, ...],
    options: Options,
) -> _Case:
    """Every hypothesis; noise is learnt about the best effect if it is not known."""
    predictor, signals = make_predictor(augmented, runs), estimate_noise(runs)
    given, nuisance = _known_noise(base, options), nuisance_names(augmented, runs)
    x = None
    noise = noisier_of(given or usual_noise(signals), signals)
    if given is None:
        options.progress("noise", 0.1)
        rough = Library(make_likelihood(predictor, noise), nuisance, effects)
        best = explain(rough, 1).best.point
        noise = learn_noise(predictor, best.parameters, best.x, best.linear, noise)
        x = best.x
    options.progress("candidates", 0.2)
    library = Library(make_likelihood(predictor, noise, x=x), nuisance, effects)
    found = explain(
        library,
        2 if options.pairs else 1,
        lambda share: options.progress("pairs", 0.2 + 0.5 * share),
    )
    verdict = judge_case(library, found, given is not None)
    best = found.best.point
    white = make_likelihood(predictor, noise, best.parameters, best.x)
    floor = noise_floor(predictor, float(signals[2]))
    return _Case(
        library, white, noise, given is not None, floor, found, verdict, blocks_of(predictor)
    )


def _with_horizons(case: _Case, found: Diagnosis, runs: Sequence[Run]) -> Diagnosis:
    """The gap over other horizons, and what it forbids to say."""
    fixed = make_space(case.library.likelihood.predictor.augmented, ())
    before = settled(case.likelihood, fixed, fixed.centre)
    best = case.settle(case.found.best if found.causes else case.found.null)
    horizons, gap, after = cross_check(
        case.predictor, runs, before, best, case.noise, (found.before, found.after)
    )
    verdict, notes = found.verdict, found.notes
    far = any(gap.position(lead) > most for lead, most in c.FAR.items())
    if verdict == "none" and far:
        verdict = "unjudged"
    leads = grown_leads(gap, after) if found.causes else ()
    if leads:
        shown = ", ".join(f"{lead:g} s" for lead in leads)
        notes = (*notes, f"position errors grow with the explanation after {shown}")
        verdict = "partial"
    return replace(found, verdict=verdict, notes=notes, horizons=horizons, before=gap, after=after)


def grown_leads(before: Gap, after: Gap) -> tuple[float, ...]:
    """Times after which the explanation leaves a larger position error than the base [s]."""
    return tuple(
        row[0] for row in before.errors if after.position(row[0]) > c.GROWN * row[1] + c.GROWN_LEAST
    )


def _conclude(
    case: _Case, options: Options, names: Sequence[str], notes: Sequence[str]
) -> Diagnosis:
    """Everything that follows from the hypotheses."""
    predictor, verdict, found = case.predictor, case.verdict, case.found
    fixed = make_space(predictor.augmented, ())
    before = settled(case.likelihood, fixed, fixed.centre)
    chosen = found.best if verdict.causes else found.null
    after = case.settle(chosen)
    spun = spun_windows(after)
    options.progress("where", 0.75)
    where = locate(case.likelihood, before, after, case.noise, case.blocks, names)
    options.progress("shrinkage", 0.85)
    shrinkage = _shrinkage(case, before, after, options)
    ambiguous = [cause for cause in verdict.causes if cause.ambiguous_with]
    following = None
    if ambiguous:
        pair = (ambiguous[0].effect, ambiguous[0].ambiguous_with[0])
        following = next_manoeuvre(case.predictor, after, case.library.nuisance, case.noise, pair)
    return Diagnosis(
        verdict=verdict.name,
        before=gap_of(predictor, before, case.blocks, spun),
        after=gap_of(predictor, after, case.blocks, spun),
        where=where,
        causes=verdict.causes,
        something_else=verdict.something_else,
        candidates=_table(found),
        shrinkage=shrinkage,
        next_manoeuvre=following,
        shape=shape_of(case.likelihood, after),
        moved=_moved(found.null),
        noise=case.noise,
        noise_known=case.known,
        notes=(*notes, *_notes(case, int(spun.sum()))),
        values=_values(predictor, chosen.point),
        timeline=timeline_of(predictor, before, after, names),
    )


def _table(found: Findings) -> tuple[tuple[str, float, float], ...]:
    """Hypotheses with their probability and what they gain over the base alone [nats]."""
    null = found.null.posterior.evidence
    return tuple(
        ("+".join(h.effects), h.probability, h.posterior.evidence - null)
        for h in found.hypotheses
        if h.effects
    )


def _values(predictor: Predictor, chosen: Point) -> dict[str, tuple[float, ...]]:
    p, places = chosen.parameters, predictor.augmented.places
    return {e: tuple(p[places(e)].tolist()) for e in chosen.space.effects}


def _shrinkage(case: _Case, before: Point, after: Point, options: Options) -> Shrinkage:
    """Predict, hand the prediction out, then measure on the reserved drives."""
    share, low, high = predict(before, after, case.floor, case.blocks, folds_of(case.predictor))
    effects, values = after.space.effects, _values(case.predictor, after)
    text = json.dumps(
        {"effects": effects, "values": values, "predicted": share, "low": low, "high": high},
        sort_keys=True,
    )
    digest = hashlib.sha256(text.encode()).hexdigest()
    options.written(text)
    predicted = Shrinkage(share, None, low, high, digest, text, None, None)
    if not options.held_out or not effects:
        return predicted
    held_out = options.held_out
    other = make_predictor(case.predictor.augmented, held_out() if callable(held_out) else held_out)
    return measure(other, after, case.noise, case.floor, predicted)


def _moved(null: Hypothesis) -> dict[str, float]:
    """z-scores of the base's parameters, in prior standard deviations, the largest first."""
    space = null.point.space
    away = (null.point.z - space.centre) / space.spread
    scores = dict(zip(space.chart.labels, away.tolist(), strict=True))
    return dict(sorted(scores.items(), key=lambda item: -abs(item[1])))


def _base_notes(augmented: AugmentedCar, base: CarFile | Model[float]) -> tuple[str, ...]:
    if isinstance(base, CarFile) and base.remark:
        return (base.remark,)
    if not augmented.sd and augmented.prior is None:
        return ("the car file gives no standard errors: ordinary ones were assumed",)
    return ()


def _notes(case: _Case, spun: int) -> tuple[str, ...]:
    notes = []
    if spun:
        count = case.predictor.layout.count
        notes.append(f"the car spun in {spun} of {count} windows: left out of the millimetres")
    if not case.known:
        notes.append("noise was learnt from these drives: a gap like noise is not identifiable")
    if len(np.unique(case.predictor.layout.run)) < 4:
        notes.append("fewer than four runs: held-out parts are blocks of the same drives")
    if case.verdict.causes and case.verdict.strain > c.STRAINED:
        notes.append("beside the cause the base moved further than its own uncertainty lets it")
    if case.found.untested:
        names = ", ".join(case.found.untested)
        notes.append(f"could not be tested, the simulation diverges with it: {names}")
    notes += [
        f"{name} is at its bound: not this, but what it makes up for"
        for name in case.verdict.at_bound
    ]
    return tuple(notes)
