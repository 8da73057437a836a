"""From scores to a verdict: is there a gap, what is its name, what else could it be, how sure."""

# Why: docs/decisions/diagnosis.md#d34

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effects import find_effect
from steerd.car_model.native.windows import SENSITIVITIES
from steerd.sim_gap.verdict.candidates import Score, gain_of, refit, scored
from steerd.sim_gap.verdict.screen import Promise, extended, screen
from steerd.sim_gap.verdict.where import conditions, turn_sign
from steerd.sysid.estimation.bounded_step import step_within
from steerd.sysid.estimation.objective import STATES
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.engine import Engine
from steerd.sysid.inference.levenberg_marquardt import Fitted, curvature, minimise
from steerd.sysid.inference.space import make_space

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Split:
    """An effect's parameter on two disjoint parts of the drives."""

    by: str
    first: float
    second: float
    sigmas: float
    broken: bool


@dataclass(frozen=True, eq=False)
class Choice:
    """The best explanation and what stands beside it.

    Attributes:
        null: the base with its parameters free within their uncertainty.
        ranked: single effects, best first.
        best: the chosen hypothesis (one effect, or two).
        blocks: (W,) windows that follow each other.
        ambiguous_with: for each effect of the best, what is not distinguishable from it.
        splits: the constancy test of the first effect.
        doubts: what counts against each effect's name.
        gain: held-out gain of the best over the base [nats]; `se` its standard error.
        found: whether that is a gap.
    """

    null: Score
    ranked: tuple[Score, ...]
    best: Score
    blocks: NDArray[np.int64]
    ambiguous_with: tuple[tuple[str, ...], ...]
    splits: tuple[Split, ...]
    doubts: tuple[float, ...]
    gain: float
    se: float
    found: bool


def is_significant(gain: float, se: float) -> bool:
    """Whether a held-out gain is no accident; a likelihood's own spread bounds its error."""
    return gain > c.GAIN_MIN and gain > c.GAIN_SE * bounded_se(gain, se)


def bounded_se(gain: float, se: float) -> float:
    """A gain's standard error; blocks that differ for good reasons barely make it larger.

    A gain of one block alone has a standard error of its own size, of k alike ones its size over
    the root of k: a part of the blocks' error always counts, so that no block decides alone.
    """
    own = c.OWN_SE * float(np.sqrt(2.0 * max(gain, 0.0)))
    return max(min(se, own), c.BLOCK_SE * se)


def best_pair(
    engine: Engine,
    null: Score,
    ranked: Sequence[Score],
    nuisance: Sequence[str],
    blocks: NDArray[np.int64],
    only: Sequence[str] | None = None,
) -> Score | None:
    """Two causes together, if they predict unseen windows clearly better than the best alone."""
    best = promising_pair(engine, ranked, nuisance, blocks, only)
    if best is None or not _are_all_large(engine, best):
        return None
    return best if needs_both(best, ranked[0], null, blocks) else None


def promising_pair(
    engine: Engine,
    ranked: Sequence[Score],
    nuisance: Sequence[str],
    blocks: NDArray[np.int64],
    only: Sequence[str] | None = None,
) -> Score | None:
    """The best two causes.

    The rest of the library is looked at again from the best single, and from the second where it is
    barely worse, so that a swap of the first cause is tried too.
    """
    best = None
    for first in ranked[: 1 + count_near(ranked, blocks)]:
        promises = screen(engine, first.fitted, nuisance, only)
        for promise in [p for p in promises[:3] if p.gain > c.PAIR_PROMISE]:
            beat = np.inf if best is None else best.fitted.cost
            pair = refit(engine, first.fitted, nuisance, [promise], beat)
            if pair is not None and (best is None or _held_out(pair) < _held_out(best)):
                best = pair
    return best


def _held_out(score: Score) -> float:
    """What a hypothesis costs on unseen windows, its base's move included [nats]."""
    return float(score.losses.sum()) + score.prior


def needs_both(pair: Score, single: Score, null: Score, blocks: NDArray[np.int64]) -> bool:
    """Whether a second cause gains enough beyond the best alone."""
    gain, se = gain_of(pair, single, blocks)
    alone, _ = gain_of(single, null, blocks)
    return gain > max(c.PAIR_MIN, c.PAIR_SHARE * alone, c.PAIR_SE * bounded_se(gain, se))


def is_large(engine: Engine, score: Score, name: str) -> bool:
    """Whether a hypothesis' effect differs from the base's by an amount that matters."""
    effect = find_effect(name)
    values = score.fitted.parameters[engine.superset.places(name)].tolist()
    return effect.size(values, engine.superset.nulls[name]) >= effect.least_size


def at_bound(engine: Engine, score: Score) -> tuple[str, ...]:
    """Effects with a parameter at a bound that is not its null: beyond what any car has."""
    places, p = engine.superset.places, score.fitted.parameters
    return tuple(
        effect.name
        for effect in engine.superset.effects
        if effect.name in score.effects and effect.is_at_bound(p[places(effect.name)].tolist())
    )


def count_near(ranked: Sequence[Score], blocks: NDArray[np.int64]) -> int:
    """1 if the second single is barely worse than the first, else 0."""
    if len(ranked) < 2:
        return 0
    lead, se = gain_of(ranked[0], ranked[1], blocks)
    return int(lead < c.AMBIGUOUS_SE * se_of_lead(lead, se) + c.AMBIGUOUS_NATS)


def is_needless(pair: Score, kept: Score, blocks: NDArray[np.int64]) -> bool:
    """Whether a pair without one of its effects predicts as well: then that one is no cause."""
    lead, se = gain_of(pair, kept, blocks)
    return lead < max(c.PAIR_MIN, c.PAIR_SE * bounded_se(lead, se))


def refit_without_each(
    engine: Engine, pair: Score, nuisance: Sequence[str]
) -> list[tuple[str, Score]]:
    """The pair without each of its effects, refitted as far as it competes."""
    out = []
    for name in pair.effects:
        kept = [e for e in pair.effects if e != name]
        space = make_space(engine.superset, nuisance, kept)
        names = pair.fitted.space.chart.free
        z = np.array([pair.fitted.z[names.index(n)] for n in space.chart.free])
        z = np.clip(z, space.low, space.high)
        fitted = minimise(engine, space, z, pair.fitted.x.copy(), beat=pair.fitted.cost)
        out.append((name, scored(engine, fitted)))
    return out


def parts_of(engine: Engine, fitted: Fitted) -> dict[str, NDArray[np.bool_]]:
    """One half of the windows for each way to split them."""
    layout, seen = engine.readings.layout, conditions(engine, fitted)
    turn = turn_sign(engine)
    halves = {
        "left or right": turn > 0.0,
        "slow or fast": seen["speed"] < np.median(seen["speed"]),
        "early or late in a run": layout.t < np.median(layout.t),
        "place (x)": seen["x"] < np.median(seen["x"]),
        "place (y)": seen["y"] < np.median(seen["y"]),
    }
    runs = np.unique(layout.run)
    if len(runs) >= 4:
        halves["odd or even runs"] = layout.run % 2 == 0
    return halves


def constancy(engine: Engine, fitted: Fitted) -> tuple[Split, ...]:
    """Whether the effect's first parameter is the same on disjoint parts of the drives."""
    place = fitted.space.nuisance
    name = fitted.space.effects[0]
    null = engine.superset.nulls[name][0]
    found = []
    for by, half in parts_of(engine, fitted).items():
        if min(half.sum(), (~half).sum()) < 6:
            continue
        (a, sa), (b, sb) = (_on_part(fitted, part, place) for part in (half, ~half))
        sigmas = abs(a - b) / float(np.hypot(sa, sb))
        apart = abs(a - b) > c.CONSTANT_SHARE * abs(fitted.z[place] - null)
        found.append(Split(by, a, b, sigmas, bool(sigmas > c.CONSTANT_SIGMA and apart)))
    return tuple(found)


def _on_part(fitted: Fitted, part: NDArray[np.bool_], place: int) -> tuple[float, float]:
    """A coordinate and its standard error on some windows, by their own quadratic forms."""
    space, at = fitted.space, fitted.at
    weight = at.weight * part
    h = np.einsum("w,wij->ij", weight, at.h) + space.precision
    slope = weight @ at.g + space.prior_pull(fitted.z)
    low, high = space.low.copy(), space.high.copy()
    low[place:], high[place:] = -np.inf, np.inf
    dz = step_within(h, slope, fitted.z, low, high)
    sd = float(np.sqrt(np.linalg.inv(h)[place, place]))
    return float(fitted.z[place] + dz[place]), sd


def signature_cosines(
    engine: Engine, fitted: Fitted, nuisance: Sequence[str], others: Sequence[str]
) -> dict[str, float]:
    """How alike other effects' signatures are to the first effect's, base eliminated (0 to 1)."""
    space, z = extended(engine, fitted, nuisance, others)
    at = engine.reduce(space, z, fitted.x)
    if not at.finite:
        return {}
    h = curvature(space, at)
    n = space.nuisance
    s = h[n:, n:] - h[n:, :n] @ np.linalg.solve(h[:n, :n], h[:n, n:])
    sizes = [len(engine.superset.places(e)) for e in space.effects]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    mine = range(starts[0], starts[1])
    out = {}
    for i, name in enumerate(space.effects[1:], start=1):
        theirs = range(starts[i], starts[i + 1])
        cross = s[np.ix_(mine, theirs)]
        left = np.linalg.solve(s[np.ix_(mine, mine)], cross)
        right = np.linalg.solve(s[np.ix_(theirs, theirs)], cross.T)
        square = float(np.max(np.real(np.linalg.eigvals(left @ right))))
        out[name] = float(np.sqrt(np.clip(square, 0.0, 1.0)))
    return out


def look_alikes(engine: Engine, fitted: Fitted, nuisance: Sequence[str]) -> dict[str, float]:
    """Cosines with every other effect that has a gradient, as many as a kernel holds."""
    own = set(fitted.space.effects)
    room, others = SENSITIVITIES - STATES - len(fitted.z), []
    for effect in engine.superset.effects:
        has_gradient = effect.name not in own and not effect.zero_gradient
        if has_gradient and len(effect.parameters) <= room:
            room -= len(effect.parameters)
            others.append(effect.name)
    return signature_cosines(engine, fitted, nuisance, others)


def indistinguishable_from(
    best: Score, others: Sequence[Score], cosines: dict[str, float], blocks: NDArray[np.int64]
) -> tuple[str, ...]:
    """What is not distinguishable from the best: nearly its gain, or nearly its signature."""
    names = []
    for other in others:
        if other.effects == best.effects:
            continue
        lead, se = gain_of(best, other, blocks)
        if lead < c.AMBIGUOUS_SE * se_of_lead(lead, se) + c.AMBIGUOUS_NATS:
            names.append(other.effects[-1])
    names += [name for name, cos in cosines.items() if cos >= c.AMBIGUOUS_COS]
    if len(best.effects) == 1:
        names += _inseparable_from(best.name)
    return tuple(dict.fromkeys(names))


def _inseparable_from(name: str) -> tuple[str, ...]:
    """Effects that no drive distinguishes from this one."""
    effect = find_effect(name)
    if effect.nameable_alone or effect.confounded_with is None:
        return ()
    return effect.confounded_with.effects


def se_of_lead(lead: float, se: float) -> float:
    """Standard error of a paired lead, no larger than twice a likelihood ratio's own."""
    return min(se, 2.0 * float(np.sqrt(2.0 * max(lead, 1.0))))


def doubt_of(best: Score, others: Sequence[Score], blocks: NDArray[np.int64]) -> float:
    """How much all candidates together count against a name, less the further they fall behind."""
    doubt = 0.0
    for other in others:
        if other.effects == best.effects:
            continue
        lead, se = gain_of(best, other, blocks)
        scaled = max(lead, 0.0) / (se_of_lead(lead, se) + c.CONFIDENCE_NATS)
        doubt += float(np.exp(-2.0 * c.CONFIDENCE_SLOPE * scaled))
    return doubt


def confidence_of(
    doubt: float, broken: bool = False, partial: bool = False, ambiguous: bool = False
) -> float:
    """How sure a name is: the share of right names among tuning cases of such doubt.

    Beside a gap that nothing explains it is no more than `PARTIAL_MOST`: tuning cases hold few
    defects outside the library, and reality holds many. Beside a name that these drives do not
    distinguish from it, it is no more than `AMBIGUOUS_MOST`.

    Args:
        doubt: see `doubt_of`.
        broken: whether halves of the drives disagree about the effect.
        partial: whether part of the gap stays.
        ambiguous: whether another effect is not distinguishable from it.
    """
    surety = -float(np.log(max(doubt, c.DOUBT_LEAST)))
    odds = c.CONFIDENCE_AT_ONE + c.CONFIDENCE_PER_SURETY * surety
    odds += c.CONFIDENCE_BROKEN * broken + c.CONFIDENCE_PARTIAL * partial
    most = min(c.PARTIAL_MOST if partial else 1.0, c.AMBIGUOUS_MOST if ambiguous else 1.0)
    return min(float(1.0 / (1.0 + np.exp(-odds))), most)


def choose(
    engine: Engine,
    null: Score,
    ranked: Sequence[Score],
    nuisance: Sequence[str],
    blocks: NDArray[np.int64],
    pairs: bool = True,
    only: Sequence[str] | None = None,
) -> Choice:
    """The explanation, what else it could be and how sure it is."""
    best = ranked[0]
    pair = best_pair(engine, null, ranked, nuisance, blocks, only) if pairs else None
    gain, se = gain_of(pair or best, null, blocks)
    found = is_significant(gain, se)
    if pair is not None and found:
        drops = refit_without_each(engine, pair, nuisance)
        alone = [kept for _, kept in drops if is_needless(pair, kept, blocks)]
        if not alone:
            return _two(engine, null, ranked, pair, nuisance, blocks, only, dict(drops))
        best = max(alone, key=lambda kept: gain_of(kept, null, blocks)[0])
        ranked = [best, *(s for s in ranked if s.effects != best.effects)]
    gain, se = gain_of(best, null, blocks)
    found = is_significant(gain, se)
    splits = constancy(engine, best.fitted) if found else ()
    others: tuple[str, ...] = ()
    if found:
        cosines = look_alikes(engine, best.fitted, nuisance)
        others = indistinguishable_from(best, ranked, cosines, blocks)
    doubt = doubt_of(best, ranked, blocks)
    return Choice(null, tuple(ranked), best, blocks, (others,), splits, (doubt,), gain, se, found)


def _two(
    engine: Engine,
    null: Score,
    ranked: Sequence[Score],
    pair: Score,
    nuisance: Sequence[str],
    blocks: NDArray[np.int64],
    only: Sequence[str] | None,
    rest: Mapping[str, Score],
    swapped: int = 0,
) -> Choice:
    """Two causes: the one whose absence costs more comes first; what else it could be from swaps.

    A swap that predicts better takes the pair's place.
    """
    worth = {name: gain_of(pair, without, blocks)[0] for name, without in rest.items()}
    order = sorted(pair.effects, key=lambda name: -worth[name])
    swaps = {
        name: _swaps(engine, rest[name], name, nuisance, only, pair.fitted.cost) for name in order
    }
    better = max(
        (s for found in swaps.values() for s in found if _are_all_large(engine, s)),
        key=lambda s: gain_of(s, pair, blocks)[0], default=pair,
    )  # fmt: skip
    if swapped < c.SWAPS and gain_of(better, pair, blocks)[0] > c.AMBIGUOUS_NATS:
        rest = dict(refit_without_each(engine, better, nuisance))
        return _two(engine, null, ranked, better, nuisance, blocks, only, rest, swapped + 1)
    others = [
        tuple(n for n in indistinguishable_from(pair, swaps[name], {}, blocks) if n != name)
        for name in order
    ]
    doubts = tuple(doubt_of(pair, swaps[name], blocks) for name in order)
    ordered = Score(tuple(order), pair.fitted, pair.losses, pair.prior)
    gain, se = gain_of(pair, null, blocks)
    return Choice(null, tuple(ranked), ordered, blocks, tuple(others), (), doubts, gain, se, True)


def _are_all_large(engine: Engine, score: Score) -> bool:
    return all(is_large(engine, score, name) for name in score.effects)


def _swaps(
    engine: Engine,
    kept: Score,
    name: str,
    nuisance: Sequence[str],
    only: Sequence[str] | None,
    beat: float,
) -> list[Score]:
    """The hypothesis with the dropped effect replaced by the most promising others."""
    promises: list[Promise] = [
        p for p in screen(engine, kept.fitted, nuisance, only) if p.effect != name and p.gain > 1.0
    ]
    found = [refit(engine, kept.fitted, nuisance, [p], beat) for p in promises[:3]]
    return [score for score in found if score is not None]
