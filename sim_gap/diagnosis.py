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
from steerd.car_model.model import Model
from steerd.sim_gap.healthy_drives import learn_healthy, refine
from steerd.sim_gap.verdict.candidates import (
    Score,
    blocks_of,
    gain_of,
    rank_singles,
    scored,
)
from steerd.sim_gap.verdict.decide import (
    Choice,
    Split,
    at_bound,
    choose,
    confidence_of,
    is_large,
)
from steerd.sim_gap.verdict.horizons import Horizon, cross_check
from steerd.sim_gap.verdict.next_manoeuvre import Manoeuvre, next_manoeuvre
from steerd.sim_gap.verdict.residual_shape import Shape, shape_of
from steerd.sim_gap.verdict.screen import screen
from steerd.sim_gap.verdict.shrinkage import Shrinkage, explained_share, measure, predict
from steerd.sim_gap.verdict.timeline import Timeline, timeline_of
from steerd.sim_gap.verdict.where import Where, locate
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.base_fit import null_fit, open_engine
from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.levenberg_marquardt import Fitted
from steerd.sysid.inference.noise import (
    Noise,
    learn_noise,
    louder,
    noise_floor,
    noise_of_section,
    whitened,
)
from steerd.sysid.inference.residuals import Gap, gap_of, ratios, robust_mean, settled
from steerd.sysid.inference.space import informative_effects, make_space, nuisance_names
from steerd.sysid.inference.superset import Superset, make_superset

Array = NDArray[np.float64]


def _silent(stage: str, share: float) -> None:
    """No progress is shown."""


def _unheard(prediction: str) -> None:
    """No one wants the prediction early."""


@dataclass(frozen=True)
class Options:
    """How to diagnose.

    Attributes:
        held_out: drives that are only opened after the prediction is written; or how to get them,
            which is then called after it.
        healthy: drives of the base car without the gap; they show how large noise is, and
            refine a base that is a car file (see `healthy.refine`).
        noise: how large noise is, if it is known (also read from the car file's `[noise]`).
        only: effects to look at; None takes the library.
        without: effects to leave out.
        pairs: whether two causes together are tried.
        jobs: threads for the candidates.
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
    jobs: int = 1
    horizons: bool = True
    progress: Callable[[str, float], None] = _silent
    written: Callable[[str], None] = _unheard


@dataclass(frozen=True)
class Cause:
    """One named effect.

    Attributes:
        effect: its name; `stage` and `family` of it.
        parameters: (value, standard error, unit) by name.
        confidence: that this name is right (0 to 1).
        ambiguous_with: effects that these drives do not distinguish from it.
        alias: what no drive distinguishes from it, in words; empty if nothing.
    """

    effect: str
    stage: str
    family: str
    parameters: dict[str, tuple[float, float, str]]
    confidence: float
    ambiguous_with: tuple[str, ...]
    alias: str


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found.

    Attributes:
        verdict: `none`, `explained`, `partial`, `unexplained` or `unjudged`.
        before: the gap of the base; `after` with the explanation.
        where: where the base's error lies.
        causes: named effects, the verdict's first.
        candidates: (effects, gain [nats], standard error) of every refitted hypothesis.
        shrinkage: predicted and, with reserved drives, measured.
        next_manoeuvre: what to drive to distinguish ambiguous causes, if there are any.
        shape: what is left.
        splits: the constancy test of the first cause.
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
    candidates: tuple[tuple[str, float, float], ...]
    shrinkage: Shrinkage
    next_manoeuvre: Manoeuvre | None
    shape: Shape
    splits: tuple[Split, ...]
    moved: dict[str, float]
    noise: Noise
    noise_known: bool
    notes: tuple[str, ...]
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    timeline: Timeline | None = None
    horizons: tuple[Horizon, ...] = ()


@dataclass(frozen=True, eq=False)
class _Case:
    """What the stages share."""

    superset: Superset
    engine: Engine
    nuisance: tuple[str, ...]
    options: Options
    only: tuple[str, ...]
    floor: float
    edited: bool = False
    untested: tuple[str, ...] = ()


def _known_noise(base: CarFile | Model[float], options: Options) -> Noise | None:
    if options.noise is not None:
        return options.noise
    if options.healthy and not isinstance(base, CarFile):
        return learn_healthy(base, options.healthy)
    return noise_of_section(base.sections.get("noise", {})) if isinstance(base, CarFile) else None


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
    superset = make_superset(base, runs)
    names = [e.name for e in superset.effects]
    informative = informative_effects(superset, runs)
    only = tuple(n for n in (options.only or informative) if n not in options.without)
    unknown = [n for n in (*only, *options.without) if n not in names]
    if unknown:
        raise ValueError(f"no effect {unknown[0]!r}; `steerd effects` lists them")
    nuisance = nuisance_names(superset, runs)
    signals, opened = estimate_noise(runs), open_engine(superset, runs)
    floor = noise_floor(opened, float(signals[2]))
    edited = isinstance(base, CarFile) and bool(base.sections.get("knowledge"))
    edited = edited and superset.knowledge is None
    case = _Case(superset, opened, nuisance, options, only, floor, edited)
    known = _known_noise(base, options)
    known = known and louder(known, signals)
    engine, null, ranked, noise, untested = _search(case, known)
    case = replace(case, untested=untested)
    options.progress("decide", 0.6)
    blocks = blocks_of(engine)
    choice = choose(engine, scored(engine, null), ranked, nuisance, blocks, options.pairs, only)
    found = _conclude(case, engine, choice, noise, known is not None, [run.name for run in runs])
    if not options.horizons:
        return found
    base_fit = settled(engine, make_space(superset, ()), make_space(superset, ()).centre)
    best = choice.best.fitted if found.causes else choice.null.fitted
    horizons, before, after = cross_check(
        engine, runs, base_fit, best, noise, (found.before, found.after)
    )
    verdict = limit_verdict(found.verdict, before)
    whole = replace(found, verdict=verdict, horizons=horizons, before=before, after=after)
    return _without_overclaim(whole, base_strain(choice.best.fitted) if found.causes else 0.0)


def base_strain(fitted: Fitted) -> float:
    """How far the base moved beside the effects, against what its uncertainty lets it.

    Its squared Mahalanobis distance less its mean, in standard deviations of chi-square.
    """
    n = fitted.space.nuisance
    square = 2.0 * fitted.space.base_cost(fitted.z)
    return (square - n) / np.sqrt(2.0 * n) if n else 0.0


def grown_leads(before: Gap, after: Gap) -> tuple[float, ...]:
    """Times after which the explanation leaves a larger position error than the base [s]."""
    return tuple(
        row[0] for row in before.errors if after.position(row[0]) > c.GROWN * row[1] + c.GROWN_LEAST
    )


def _without_overclaim(found: Diagnosis, strain: float) -> Diagnosis:
    """Nothing is `explained` whose errors grow in millimetres, or whose base is not the base."""
    notes = []
    if found.causes and grown_leads(found.before, found.after):
        leads = ", ".join(f"{lead:g} s" for lead in grown_leads(found.before, found.after))
        notes.append(f"position errors grow with the explanation after {leads}")
    if strain > c.STRAINED:
        notes.append("beside the cause the base moved further than its own uncertainty lets it")
    if not notes or found.verdict != "explained":
        return replace(found, notes=(*found.notes, *notes))
    causes = tuple(
        replace(cause, confidence=min(cause.confidence, c.PARTIAL_MOST)) for cause in found.causes
    )
    return replace(found, verdict="partial", causes=causes, notes=(*found.notes, *notes))


def _search(
    case: _Case, known: Noise | None
) -> tuple[Engine, Fitted, list[Score], Noise, tuple[str, ...]]:
    """Base, noise and single effects; noise is learnt about the best effect if it is not known.

    Last come the effects whose simulation did not stay finite.
    """
    engine, options = case.engine, case.options
    options.progress("base", 0.05)
    null = null_fit(engine, case.nuisance)
    noise = known or learn_noise(engine, null)
    engine = whitened(engine, null, noise)
    null = null_fit(engine, case.nuisance, null)
    options.progress("candidates", 0.2)
    most = c.REFITS if known else c.REFITS_ROUGH
    promises = screen(engine, null, case.nuisance, case.only)
    untested = tuple(p.effect for p in promises if not p.tested)
    free = case.nuisance, case.only, options.jobs
    null, ranked = rank_singles(engine, null, *free, most, promises)
    if not ranked:
        return engine, null, [scored(engine, null)], noise, untested
    if known is None:
        best = ranked[0].fitted
        noise = learn_noise(engine, best, noise)
        engine = whitened(engine, best, noise)
        null = null_fit(engine, case.nuisance, null)
        options.progress("candidates again", 0.4)
        null, again = rank_singles(engine, null, *free, c.REFITS)
        ranked = again or ranked
    return engine, null, ranked, noise, untested


def _conclude(
    case: _Case, engine: Engine, choice: Choice, noise: Noise, known: bool, names: Sequence[str]
) -> Diagnosis:
    """Everything that follows from the choice."""
    fixed = make_space(case.superset, ())
    before = settled(engine, fixed, fixed.centre, choice.null.fitted.x)
    gap_before = gap_of(engine, before, choice.blocks)
    best = choice.best.fitted
    gap_best = gap_of(engine, best, choice.blocks)
    gap_null = gap_of(engine, choice.null.fitted, choice.blocks)
    level = case.floor if known else np.inf
    sizes = (is_large(engine, choice.best, name) for name in choice.best.effects)
    matters = is_practical(choice, gap_before, gap_best, gap_null, level)
    found = choice.found and all(sizes) and matters
    chosen, gap_after = (choice.best, gap_best) if found else (choice.null, gap_null)
    mostly = share_of_most(before, chosen.fitted, case.floor)
    typical = typical_ratio(chosen.fitted)
    verdict = verdict_of(choice, found, known, gap_before, gap_after, case.floor, mostly, typical)
    extreme = at_bound(engine, choice.best)
    verdict = limit_verdict(verdict, gap_before, extreme)
    case.options.progress("where", 0.75)
    where = locate(engine, before, chosen.fitted, noise, choice.blocks, names)
    causes = _causes(engine, choice, verdict) if found and verdict != "unexplained" else ()
    case.options.progress("shrinkage", 0.85)
    shrinkage = _shrinkage(case, engine, before, chosen, choice, noise)
    ambiguous = [cause for cause in causes if cause.ambiguous_with]
    following = None
    if ambiguous:
        pair = (ambiguous[0].effect, ambiguous[0].ambiguous_with[0])
        following = next_manoeuvre(engine, choice.best.fitted, case.nuisance, noise, pair)
    base = choice.null
    table = [(s.name, *gain_of(s, base, choice.blocks)) for s in choice.ranked if s.effects]
    if len(choice.best.effects) > 1:
        table.insert(0, (choice.best.name, choice.gain, choice.se))
    values = _values(engine, choice.best) if causes else {}
    return Diagnosis(
        verdict, gap_before, gap_after, where, causes, tuple(table), shrinkage, following,
        shape_of(engine, chosen.fitted, noise), choice.splits, _moved(base.fitted), noise, known,
        _notes(case, known, choice, extreme if found else ()), values,
        timeline_of(engine, before, chosen.fitted, names),
    )  # fmt: skip


def is_practical(choice: Choice, before: Gap, after: Gap, null: Gap, floor: float) -> bool:
    """Whether adding the effect matters: a share, millimetres, or overwhelming odds.

    Beside the base with its parameters free in their uncertainty stands the base as it is: where
    that leaves clearly more than noise, a share of the excess is enough.

    Args:
        choice: the explanation.
        before: the gap of the base as it is.
        after: of the explanation.
        null: of the base with its parameters free.
        floor: what noise alone leaves; infinite if that is not known.
    """
    moved = null.position(1.0) - after.position(1.0)
    share = (null.whitened - after.whitened) / max(null.whitened, 1e-9)
    clear = c.GAIN_CLEAR * max(1.0, len(choice.blocks) / c.CLEAR_WINDOWS)
    seen = before.interval[0] > c.EXCESS_LEFT * floor and (
        explained_share(before.whitened, after.whitened, floor) >= c.SHARE_MIN
    )
    return seen or moved >= c.SPEED_MIN or share >= c.SHARE_MIN or choice.gain >= clear


def share_of_most(before: Fitted, after: Fitted, floor: float) -> float:
    """Share of the excess that is gone from all windows but the worst few."""
    left = ratios(after)
    kept = left <= np.quantile(left, 1.0 - c.SPARED)
    return explained_share(robust_mean(ratios(before)[kept]), robust_mean(left[kept]), floor)


def typical_ratio(fitted: Fitted) -> float:
    """Whitened error of all windows but the worst few."""
    left = ratios(fitted)
    return robust_mean(left[left <= np.quantile(left, 1.0 - c.SPARED)])


def verdict_of(
    choice: Choice,
    found: bool,
    known: bool,
    before: Gap,
    after: Gap,
    floor: float,
    mostly: float = 0.0,
    typical: float = np.inf,
) -> str:
    """`none`, `explained`, `partial` or `unexplained`.

    Args:
        choice: the explanation.
        found: whether it counts as a gap.
        known: whether noise is known from elsewhere.
        before: the base's gap; `after` the explanation's.
        after: see `before`.
        floor: what noise alone leaves.
        mostly: share of the excess that is gone from all windows but the worst few: a car that
            locks its wheels now and then may be explained the rest of the time.
        typical: what is left of all windows but the worst few: a few seconds in which the car
            spun are no gap of its model everywhere.
    """
    most = c.EXCESS_LEFT * floor
    if not found:
        alone = min(after.interval[0], typical) > c.EXCESS_ALONE * floor
        alone = alone and after.position(1.0) >= c.SPEED_MIN
        return "unexplained" if known and alone else "none"
    share = explained_share(before.whitened, after.whitened, floor)
    if known and after.interval[0] > most and max(share, mostly) < c.PARTIAL_MIN:
        return "unexplained"
    if known and after.whitened > most and share < c.EXPLAINED_MIN:
        return "partial"
    return "partial" if any(split.broken for split in choice.splits) else "explained"


def limit_verdict(verdict: str, before: Gap, extreme: Sequence[str] = ()) -> str:
    """The verdict, with what forbids to believe it.

    Noise learnt from drives that are far off holds all of it, so `none` becomes `unjudged`; an
    effect at its bound (`extreme`) makes up for something else, so `explained` becomes `partial`.
    """
    if verdict == "explained" and extreme:
        return "partial"
    far = any(before.position(lead) > most for lead, most in c.FAR.items())
    return "unjudged" if verdict == "none" and far else verdict


def _values(engine: Engine, score: Score) -> dict[str, tuple[float, ...]]:
    p = score.fitted.parameters
    return {e: tuple(float(p[i]) for i in engine.superset.places(e)) for e in score.effects}


def _causes(engine: Engine, choice: Choice, verdict: str) -> tuple[Cause, ...]:
    broken, partial = any(split.broken for split in choice.splits), verdict == "partial"
    fitted = choice.best.fitted
    sd = dict(zip(fitted.space.chart.free, np.sqrt(np.diag(fitted.covariance)), strict=True))
    p, names = fitted.parameters, engine.superset.kernels.names
    effects = {e.name: e for e in engine.superset.effects}
    causes = []
    named = zip(choice.best.effects, choice.ambiguous_with, choice.doubts, strict=True)
    for name, others, doubt in named:
        effect = effects[name]
        places = engine.superset.places(name)
        parameters = {
            q.name: (float(p[i]), float(sd[names[i]]), q.unit)
            for q, i in zip(effect.parameters, places, strict=True)
        }
        sure = confidence_of(doubt, broken, partial, bool(others))
        alias = effect.confounded_with.note if effect.confounded_with else ""
        causes.append(
            Cause(name, effect.stage.value, effect.family, parameters, sure, others, alias)
        )
    return tuple(causes)


def _shrinkage(
    case: _Case, engine: Engine, before: Fitted, chosen: Score, choice: Choice, noise: Noise
) -> Shrinkage:
    """Predict, hand the prediction out, then measure on the reserved drives."""
    share, low, high = predict(before, chosen, case.floor, choice.blocks)
    text = json.dumps(
        {"effects": chosen.effects, "values": _values(engine, chosen),
         "predicted": share, "low": low, "high": high}, sort_keys=True,
    )  # fmt: skip
    digest = hashlib.sha256(text.encode()).hexdigest()
    case.options.written(text)
    if not case.options.held_out or not chosen.effects:
        return Shrinkage(share, None, low, high, digest, text, None, None)
    held_out = case.options.held_out
    other = open_engine(case.superset, held_out() if callable(held_out) else held_out)
    return measure(other, chosen, noise, case.floor, (share, low, high), digest, text)


def _moved(null: Fitted) -> dict[str, float]:
    """z-scores of the base's parameters, in prior standard deviations, the largest first."""
    scores = dict(zip(null.space.chart.labels, null.prior.tolist(), strict=True))
    return dict(sorted(scores.items(), key=lambda item: -abs(item[1])))


def _notes(case: _Case, known: bool, choice: Choice, extreme: Sequence[str]) -> tuple[str, ...]:
    notes = []
    if case.edited:
        notes.append("the car file was edited since identify wrote [knowledge]: it is not used")
    if not case.superset.sd and case.superset.knowledge is None:
        notes.append("the car file gives no standard errors: ordinary ones were assumed")
    if not known:
        notes.append("noise was learnt from these drives: a gap like noise is not identifiable")
    if len(np.unique(case.engine.readings.layout.run)) < 4:
        notes.append("fewer than four runs: held-out parts are blocks of the same drives")
    notes += [f"{s.by}: {s.first:.4g} against {s.second:.4g} ({s.sigmas:.1f} sigma)"
              for s in choice.splits if s.broken]  # fmt: skip
    if case.untested:
        names = ", ".join(case.untested)
        notes.append(f"could not be tested, the simulation diverges with it: {names}")
    notes += [f"{name} is at its bound: not this, but what it makes up for" for name in extreme]
    return tuple(notes)
