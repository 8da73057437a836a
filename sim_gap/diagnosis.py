"""The whole diagnosis: where the gap lies, which effect causes it, how far adding it shrinks it.

`diagnose` is a pure function of the drives and the base car (but for an optional callback that is
handed the prediction before the reserved drives are looked at).
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.car_model.effect import Effect
from steerd.sim_gap.lane_comparison import LaneComparison
from steerd.sim_gap.verdict.confidence import Cause, Verdict, judge_case
from steerd.sim_gap.verdict.next_manoeuvre import Manoeuvre, next_manoeuvre
from steerd.sim_gap.verdict.residual_shape import Shape, Timeline, shape_of, timeline_of
from steerd.sim_gap.verdict.shrinkage import Horizon, Shrinkage, cross_check, measure, predict
from steerd.sim_gap.verdict.where import Fits, Where, locate
from steerd.sysid.data.dataset import Run, check_sources
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import AugmentedCar, make_augmented_car
from steerd.sysid.inference.car_posterior import refine
from steerd.sysid.inference.hypotheses import Findings, explain
from steerd.sysid.inference.library import Library
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.noise import (
    Noise,
    learn_noise,
    noise_floor,
    noise_of_section,
    noisier_of,
    usual_noise,
)
from steerd.sysid.inference.predictor import open_predictor
from steerd.sysid.inference.residuals import Gap, Lead, settled, spun_windows
from steerd.sysid.inference.search import Point
from steerd.sysid.inference.space import informative_effects, make_space, nuisance_names


@dataclass(frozen=True, kw_only=True)
class GapOptions:
    """What is looked for."""

    only: Sequence[str] = ()  # effects to look at; empty for the library
    without: Sequence[str] = ()  # effects to leave out
    pairs: bool = True  # whether two causes together are tried


@dataclass(frozen=True, eq=False)
class Case:
    """What is diagnosed, and what a reader should know of it."""

    runs: Sequence[Run]  # to explain; one is split into blocks, several are left out whole
    # The car as identified; with standard errors its own uncertainty is known, without them
    # ordinary ones are assumed (and said); with `[noise]` it is known how large noise is
    base: CarFile
    asked: GapOptions = field(default_factory=GapOptions)
    # Opens the drives that are held out, after the prediction is written; None if there are none
    later: Callable[[], Sequence[Run]] | None = None
    healthy: Sequence[Run] = ()  # drives of the base car without the gap; they `refine` it
    horizons: bool = True  # whether the gap is looked at over other horizons too
    sessions: tuple[str, ...] = ()  # names of the files
    base_source: str = ""  # where the base comes from, as text
    held_out_of: str = ""  # what is held out, as text
    notes: tuple[str, ...] = ()  # what a reader should know about the drives

    @property
    def seconds(self) -> float:
        """Driving that is looked at [s]."""
        return sum(run.driven for run in self.runs)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found."""

    case: Case  # what was diagnosed
    verdict: str  # `none`, `explained`, `partial`, `unexplained` or `unjudged`
    before: Gap  # the gap of the base; `after` with the explanation
    after: Gap
    where: Where  # where the base's error lies
    causes: tuple[Cause, ...]  # named effects, the verdict's first
    something_else: float  # posterior probability that no effect of the library is a cause
    # (effects, probability, gain over the base alone [nats]) of each hypothesis
    candidates: tuple[tuple[str, float, float], ...]
    shrinkage: Shrinkage  # predicted and, with reserved drives, measured
    next_manoeuvre: Manoeuvre | None  # to distinguish ambiguous causes, if there are any
    shape: Shape  # what is left
    moved: dict[str, float]  # z-scores of base parameters that moved, the largest first
    noise: Noise  # what was taken as random; `noise_known` if not from these drives
    noise_known: bool
    notes: tuple[str, ...]  # what a reader should know about how this was done
    values: dict[str, tuple[float, ...]]  # parameters of the explanation by effect, for a car file
    timeline: Timeline  # the gap window by window
    horizons: tuple[Horizon, ...] = ()  # the gap over other horizons
    lane: LaneComparison | None = None  # a session's lane, driven again in simulation
    lane_note: str = ""  # why it was not; empty if it was, or was not asked for

    @property
    def leads(self) -> list[tuple[Lead, Lead]]:
        """Errors before and after by lead; windows may end just before the last."""
        pairs = zip(self.before.errors, self.after.errors, strict=True)
        return [pair for pair in pairs if pair[0].position.value > 0.0]

    @property
    def all_notes(self) -> tuple[str, ...]:
        """What a reader should know about drives, method and closed loop."""
        return (*self.case.notes, *self.notes, *filter(None, [self.lane_note]))

    def __repr__(self) -> str:
        names = ", ".join(cause.effect for cause in self.causes)
        return f"<Diagnosis: {self.verdict}{names and f', {names}'}>"


Progress = Callable[[str, float], None]  # is called with a stage's name and the share done


class _Search(NamedTuple):
    """Every hypothesis, and what they were judged by."""

    case: Case
    library: Library  # windows, free parameters of the base, effects
    likelihood: Likelihood  # the windows, their responses taken about the likeliest hypothesis
    noise: Noise  # what was taken as random; `known` if not from these drives
    known: bool
    floor: float  # what noise leaves of the whitened error
    found: Findings  # every hypothesis


def diagnose(
    case: Case,
    progress: Progress = lambda stage, share: None,
    written: Callable[[str], None] = lambda prediction: None,
) -> Diagnosis:
    """Diagnose the gap between a base car and drives.

    `written` is called with the prediction (JSON) before the reserved drives are opened.

    Raises:
        DataError: the drives are not fit for it.
        ValueError: runs on different grids, or an unknown effect.
        FloatingPointError: the base car's simulation diverges.
    """
    if case.healthy:
        case = replace(case, base=refine(case.base, case.healthy))
    check_sources(case.runs)
    augmented = make_augmented_car(case.base, case.runs)
    only = _chosen(augmented, case)
    progress("base", 0.05)
    return _conclude(_search(augmented, case, only, progress), progress, written)


def _chosen(augmented: AugmentedCar, case: Case) -> tuple[Effect, ...]:
    """Effects that may be a cause.

    Raises:
        ValueError: an option names none.
    """
    asked, names = case.asked, [e.name for e in augmented.effects]
    unknown = [n for n in (*asked.only, *asked.without) if n not in names]
    if unknown:
        raise ValueError(f"no effect {unknown[0]!r}; `steerd effects` lists them")
    only = asked.only or informative_effects(augmented, case.runs)
    wanted = [e for e in augmented.effects if e.name in only and e.name not in asked.without]
    return tuple(e for e in wanted if e.changes or asked.only)


def _search(
    augmented: AugmentedCar, case: Case, effects: tuple[Effect, ...], progress: Progress
) -> _Search:
    """Every hypothesis; noise is learnt about the best effect if it is not known."""
    predictor, signals = open_predictor(augmented, case.runs), estimate_noise(case.runs)
    nuisance = nuisance_names(augmented, case.runs)
    given = noise_of_section(case.base.sections.get("noise", {}))
    x, parameters = predictor.guess.copy(), augmented.base
    noise = noisier_of(given or usual_noise(signals), signals)
    if given is None:
        progress("noise", 0.1)
        rough = Library(make_likelihood(predictor, parameters, x, noise), nuisance, effects)
        best = explain(rough, 1).best.point
        noise = learn_noise(predictor, best.parameters, best.x, best.linear, noise)
        x = best.x
    progress("candidates", 0.2)
    library = Library(make_likelihood(predictor, parameters, x, noise), nuisance, effects)
    count = 2 if case.asked.pairs else 1
    found = explain(library, count, lambda share: progress("pairs", 0.2 + 0.5 * share))
    best = found.best.point
    white = make_likelihood(predictor, best.parameters, best.x, noise)
    floor = noise_floor(predictor, float(signals[2]))
    return _Search(case, library, white, noise, given is not None, floor, found)


def grown_leads(before: Gap, after: Gap) -> tuple[float, ...]:
    """Times after which the explanation leaves a larger position error than the base [s]."""
    most = {e.seconds: c.GROWN * e.position.value + c.GROWN_LEAST for e in before.errors}
    return tuple(lead for lead in most if after.position(lead) > most[lead])


def is_far(gap: Gap) -> bool:
    """Whether position errors surely are larger than noise excuses; one spin is metres long."""
    return any(e.position.low > c.FAR.get(e.seconds, np.inf) for e in gap.errors)


def _conclude(search: _Search, progress: Progress, written: Callable[[str], None]) -> Diagnosis:
    """Everything that follows from the hypotheses."""
    found, case = search.found, search.case
    judged = judge_case(search.library, found, search.known)
    fits = _fit_both(search, (found.best if judged.causes else found.null).point)
    gaps = fits.gaps()
    progress("where", 0.75)
    where = locate(fits)
    progress("shrinkage", 0.85)
    shrinkage = _shrinkage(fits, case, written)
    pairs = [(each.effect, each.ambiguous_with[0]) for each in judged.causes if each.ambiguous_with]
    following = next_manoeuvre(fits, search.library.nuisance, pairs[0]) if pairs else None
    verdict, notes = judged.name, _notes(search, judged, fits)
    horizons: tuple[Horizon, ...] = ()
    if case.horizons:
        horizons, gaps = cross_check(fits, case.runs, gaps)
        verdict = "unjudged" if verdict == "none" and is_far(gaps[0]) else verdict
        if judged.causes and (leads := grown_leads(*gaps)):
            shown = ", ".join(f"{lead:g} s" for lead in leads)
            notes.append(f"position errors grow with the explanation after {shown}")
            verdict = "partial"
    null, space = found.null, found.null.point.space
    level, away = null.posterior.evidence, (null.point.z - space.centre) / space.spread
    # Of the names' probability as much as the verdict leaves them beside something else
    share = (1.0 - judged.something_else) / max(1.0 - null.probability, np.finfo(float).tiny)
    moved = zip(space.chart.labels, away.tolist(), strict=True)
    return Diagnosis(
        case=case,
        verdict=verdict,
        before=gaps[0],
        after=gaps[1],
        where=where,
        causes=judged.causes,
        something_else=judged.something_else,
        candidates=tuple(
            ("+".join(h.effects), share * h.probability, h.posterior.evidence - level)
            for h in found.hypotheses
            if h.effects
        ),
        shrinkage=shrinkage,
        next_manoeuvre=following,
        shape=shape_of(fits),
        moved=dict(sorted(moved, key=lambda item: -abs(item[1]))),
        noise=search.noise,
        noise_known=search.known,
        notes=tuple(notes),
        values=fits.values,
        timeline=timeline_of(fits),
        horizons=horizons,
    )


def _fit_both(search: _Search, chosen: Point) -> Fits:
    """The base, and the chosen hypothesis, with the windows' starts at their best."""
    likelihood, fixed = search.likelihood, make_space(search.likelihood.predictor.augmented, ())
    before = settled(likelihood, fixed, fixed.centre)
    after = settled(likelihood, chosen.space, chosen.z, chosen.x)
    names = [run.name for run in search.case.runs]
    return Fits(likelihood, before, after, search.noise, search.floor, names)


def _shrinkage(fits: Fits, case: Case, written: Callable[[str], None]) -> Shrinkage:
    """Predict, hand the prediction out, then measure on the reserved drives."""
    share, low, high, _ = predict(fits)
    shares = {"predicted": share, "low": low, "high": high}
    explained = {"effects": fits.after.space.effects, "values": fits.values}
    text = json.dumps(explained | shares, sort_keys=True)
    predicted = Shrinkage(share, low, high, text, hashlib.sha256(text.encode()).hexdigest())
    written(text)
    if case.later is None or not fits.values:
        return predicted
    reserved = case.later()
    check_sources((*case.runs, *reserved))
    return measure(fits, open_predictor(fits.predictor.augmented, reserved), predicted)


def _notes(search: _Search, judged: Verdict, fits: Fits) -> list[str]:
    """What a reader should know about how it was done."""
    base, augmented, layout = search.case.base, fits.predictor.augmented, fits.predictor.layout
    notes, spun = [], int(spun_windows(fits.after).sum())
    if base.remark:
        notes.append(base.remark)
    elif not augmented.sd and augmented.knowledge is None:
        notes.append("the car file gives no standard errors: ordinary ones were assumed")
    if spun:
        text = f"the car spun in {spun} of {layout.count} windows"
        notes.append(f"{text}: left out of the millimetres")
    if not search.known:
        notes.append("noise was learnt from these drives: a gap like noise is not identifiable")
    if len(np.unique(layout.run)) < 4:
        notes.append("fewer than four runs: held-out parts are blocks of the same drives")
    if fits.likelihood.left > c.GAP_SIZE:
        notes.append("the base does not hold the drives that it was identified from either")
    if judged.causes and judged.strain > c.STRAINED:
        notes.append("beside the cause the base moved further than its own uncertainty lets it")
    if search.found.untested:
        names = ", ".join(search.found.untested)
        notes.append(f"could not be tested, the simulation diverges with it: {names}")
    bounded = (f"{n} is at its bound: not this, but what it makes up for" for n in judged.at_bound)
    return [*notes, *bounded, *_offsets(judged, fits)]


def _offsets(judged: Verdict, fits: Fits) -> Iterator[str]:
    """Where the base is off by itself, so that the simulation takes less or more of a cause."""
    for cause in judged.causes:
        rows = zip(cause.parameters.items(), fits.values[cause.effect], strict=True)
        for (name, (value, sd, unit)), taken in rows:
            if abs(taken - value) > sd:
                off, unit = taken - value, "" if unit == "1" else f" {unit}"
                text = f"{cause.effect}: the base car is off by {off:.3g}{unit} by itself"
                yield f"{text}, so simulation and car file take {name} = {taken:.3g}{unit}"
