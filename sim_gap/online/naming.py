"""The car as it was before a change, and what changed: the inference of `diagnose`, live.

Base and noise are learnt on the first windows of a drive. After a change, the last seconds are
diagnosed: the base is the car as it was learnt, its uncertainty what the drive left of it; windows,
likelihood, hypotheses and verdict are those of `steerd.sysid.inference`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from steerd.sim_gap.online import tracking
from steerd.sim_gap.online.changes import SPANS, QuietRatios, quiet_ratios_of
from steerd.sim_gap.online.samples import WINDOW
from steerd.sim_gap.online.tracking import Reference, Remembered, Seen, Track
from steerd.sim_gap.verdict.confidence import Cause, Verdict, judge_case
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference.augmented_car import AugmentedCar, BasePrior
from steerd.sysid.inference.hypotheses import begin, explain
from steerd.sysid.inference.library import Library
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.noise import Noise, learn_noise, usual_noise
from steerd.sysid.inference.predictor import open_predictor
from steerd.sysid.inference.search import minimise, stand
from steerd.sysid.inference.space import make_space, nuisance_names

LOOKS = (5, 6, 8, 11, 16, 21, 27, 34, 42, 50)
"""Windows after a change at which they are diagnosed: each time costs a third of a second."""
LATEST = 30  # windows that are diagnosed at most, the newest: what came slowly is over in them
EARLY = 8
"""Before so many windows it is too early to say that nothing explains a change, or that there was
none."""


@dataclass(frozen=True)
class Finding:
    """What is said of a change."""

    verdict: str = "changed"  # `changed` (too early to say), `named`, `unexplained` or `none`
    cause: Cause | None = None  # the effect, where it is named
    sure: float = 0.0  # probability that it, or one that it is ambiguous with, is the cause


def find_cause(reference: Reference, before: Track, windows: Sequence[Run]) -> Finding:
    """What the windows since a change say of it, by what was known of the base before.

    The first may hold the change itself and is left out.
    """
    try:
        verdict = _diagnose(believed(reference, before), reference, windows[1:][-LATEST:])
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return Finding()
    if verdict.causes:
        return Finding("named", verdict.causes[0], 1.0 - verdict.something_else)
    if len(windows) < EARLY:
        return Finding()
    return Finding("none" if verdict.name == "none" else "unexplained")


def believed(reference: Reference, track: Track) -> AugmentedCar:
    """The reference's car with what was learnt about it: the same drive, so no wider."""
    space = reference.space
    n, z = space.nuisance, space.centre.copy()
    z[:n] += track.mean
    learnt = replace(reference.augmented, base=space.chart.parameters(z))
    known, names = learnt.knowledge or BasePrior((), track.covariance), space.chart.free[:n]
    known = BasePrior(names, track.covariance, size=known.size, least=known.least)
    return replace(learnt, knowledge=known)


def _diagnose(base: AugmentedCar, reference: Reference, runs: Sequence[Run]) -> Verdict:
    """The verdict on windows.

    Raises:
        ValueError: no window sees enough poses.
        FloatingPointError: the base's simulation leaves the map.
    """
    predictor = open_predictor(base, runs, WINDOW, late=reference.late)
    likelihood = make_likelihood(predictor, base.base, predictor.guess, reference.noise)
    possible = tracking.may_change(base, runs)
    effects = tuple(e for e in base.effects if e.name in possible)
    nuisance = reference.space.chart.free[: reference.space.nuisance]
    library = Library(likelihood, nuisance, effects)
    return judge_case(library, explain(library, 1), known=True)


@dataclass(frozen=True, eq=False)
class Known:
    """The car as learnt, and what was seen since."""

    reference: Reference  # the car, and its noise
    track: Track  # what is known of the base now
    usual: QuietRatios  # what ratios the car shows while nothing is the matter
    seen: tuple[Seen, ...] = ()  # the last windows, oldest first
    shown: tuple[Array, ...] = ()  # ratios of windows that may yet turn out to be a change's
    peak: float = 0.0  # the largest ratio per what is usual so far that called no change [nats]


def learn(
    augmented: AugmentedCar,
    windows: Sequence[tuple[float, Run]],
    noise: Noise | None,
    remembered: Remembered = MappingProxyType({}),
) -> Known | None:
    """The car as it is in windows (when each began [s], and its drive), from a car file's base.

    What an earlier drive learnt is left out where these windows contradict it. None where the
    base's simulation leaves the map.
    """
    times, runs = [t for t, _ in windows], [run for _, run in windows]
    nuisance = nuisance_names(augmented, runs)
    known = {name.partition(".")[0] for name in nuisance if "." in name}
    built_in = tuple(e.name for e in augmented.effects if e.on_every_car and e.name not in known)
    try:
        predictor = open_predictor(augmented, runs, WINDOW)
        x, rough = predictor.guess, noise or usual_noise(estimate_noise(runs))
        likelihood = make_likelihood(predictor, augmented.base, x, rough)
        library = Library(likelihood, nuisance, (), known=False)
        fitted = minimise(likelihood, begin(library, built_in, (), x))
        noise = learn_noise(predictor, fitted.parameters, fitted.x, fitted.linear, noise)
        likelihood = make_likelihood(predictor, fitted.parameters, fitted.x, noise)
        begun = stand(likelihood, fitted.space, fitted.z, fitted.x, fitted.size)
        fitted = minimise(likelihood, begun)
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None
    learnt = replace(augmented, base=fitted.parameters)
    flat = {e.name for e in augmented.effects if e.zero_gradient}
    sloped = [name for name in tracking.may_change(learnt, runs) if name not in flat]
    reference = Reference(learnt, make_space(learnt, nuisance, sloped), noise)
    try:
        at = stand(likelihood, reference.space, reference.space.centre, fitted.x, 0.0).at
    except FloatingPointError:
        return None
    looks = tracking.looks_of(at, times)
    n = reference.space.nuisance
    prior = np.asarray(np.linalg.inv(reference.space.covariance[:n, :n]), np.float64)
    informed = sum((each.weight * each.h[:n, :n] for each in looks), np.zeros((n, n)))
    # The windows made the reference: about it they pull nowhere.
    alone = Track(prior + informed, np.zeros(n), prior)
    track = tracking.with_memory(reference, alone, remembered)
    seen = tuple(Seen(track, window) for window in looks)
    return Known(reference, track, quiet_ratios_of(reference, seen), seen[-SPANS[-1] :])
