"""The learner: `fold(learner, state, sample)` gives the next state and, once a second, a report.

Pure: no clock, no file, no randomness, so a recording gives what the drive gave, to the byte. At
first it learns the car as it is (`naming`), then it follows it (`tracking`) and watches for a
change (`changes`); after one it says what changed (`naming`), and learns the car anew.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from steerd.car_model.car_file import CarFile
from steerd.sim_gap.online import samples, tracking
from steerd.sim_gap.online.changes import SPANS, ratios, reweighted
from steerd.sim_gap.online.naming import LOOKS, Finding, Known, find_cause, learn
from steerd.sim_gap.online.tracking import Loss, Memory, Remembered, Seen, Track
from steerd.sim_gap.verdict.confidence import Cause
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.augmented_car import AugmentedCar, make_augmented_car
from steerd.sysid.inference.noise import Noise, noise_of_section
from steerd.sysid.inference.space import FLOORS, LIMITS, least_sd

REFERENCE = 50  # windows that the car is learnt from: 25 s, two laps of an ordinary figure-eight
ALARM = 20.0  # a change is called at this ratio per what is usual [nats]
DOUBT = 5.0  # windows at which a ratio is larger are not followed, and not usual [nats]
SETTLED = 16  # windows after which a change's name counts: eight seconds, a lap of a small eight
DELAY = 8  # what a window shows counts as usual only so many windows later
FADING = 1.0 / 1200.0  # share of what is usual that is forgotten with a window: ten minutes
PERIOD = 1.0  # time between reports [s]
NOT_IDENTIFIED = 20.0
"""Standard errors of a car file that gives none, per the least that any car's are: a tenth of a
stiffness, 0.01 rad of a bias. The first half minute of a drive identifies most of them."""
BETTER_KNOWN = {"lf": 2.5, "lr": 2.5, "steer_gain": 8.0, "c_x": 2.0}
"""The same for what a ruler, a protractor or the class of the car gives better: along the valley of
a longer car that steers more (see `chart`) a lane would pull them to where no car is."""


@dataclass(frozen=True, eq=False)
class Learner:
    """What does not change while a car is learnt."""

    augmented: AugmentedCar  # the car file's base, with every effect of the library
    noise: Noise | None = None  # as the car file knows it
    remembered: Remembered = field(default_factory=dict)  # of an earlier drive of this car


def make_learner(car: CarFile, memory: Memory | None = None) -> Learner:
    """A learner about a car file: as identified, or with its figures as published.

    `memory` is of an earlier drive of this car.

    Raises:
        ValueError: what identify wrote into the file is not what it writes.
    """
    augmented = make_augmented_car(car, ())
    if augmented.knowledge is None and not augmented.sd:
        augmented = replace(augmented, sd=_published(augmented))
    remembered = tracking.remember(augmented, memory) if memory is not None else {}
    return Learner(augmented, noise_of_section(car.sections.get("noise", {})), remembered)


def _published(augmented: AugmentedCar) -> dict[str, float]:
    """Standard errors of figures that were published for another car of the class."""
    factors = {n: BETTER_KNOWN.get(n, NOT_IDENTIFIED) for n in FLOORS if n not in LIMITS}
    return {name: factor * least_sd(augmented, name) for name, factor in factors.items()}


@dataclass(frozen=True, eq=False)
class Change:
    """A change that is being looked into."""

    since: float  # when it began [s]; `noticed` when it was called [s]
    noticed: float
    before: Track  # what was known of the base before it
    windows: tuple[tuple[float, Run], ...]  # those since, with their times
    finding: Finding = field(default_factory=Finding)  # what is said of it
    was: tuple[float, ...] = ()  # what the named effect's parameters were before it
    # The last name that stood alone once the change had settled, and what its parameters were
    # before
    proven: tuple[Cause, tuple[float, ...]] | None = None


@dataclass(frozen=True, eq=False)
class State:
    """Everything that the learner remembers."""

    recent: samples.Recent = field(default_factory=samples.Recent)  # samples of the last seconds
    start: float = -np.inf  # when the next window begins [s]
    windows: tuple[tuple[float, Run], ...] = ()  # that the car is learnt from, with their times
    known: Known | None = None  # the car as learnt; None before
    change: Change | None = None  # what is being looked into; None while nothing is the matter
    past: tuple[Change, ...] = ()  # changes that the car was learnt anew after, oldest first
    taken_back: int = 0  # changes that did not hold
    seen: int = 0  # windows so far; `due` when the next report is due [s]
    due: float = -np.inf


def fold(learner: Learner, state: State, sample: samples.Sample) -> tuple[State, bool]:
    """Take in one sample; whether a report of the state is due."""
    state = replace(state, recent=samples.take(state.recent, sample))
    if not isinstance(sample, samples.PoseSeen):
        return state, False
    state = _close_window(learner, state)
    if sample.t < state.due:
        return state, False
    first = not np.isfinite(state.due)
    behind = sample.t - state.due > PERIOD
    due = sample.t + PERIOD if first or behind else state.due + PERIOD
    return replace(state, due=due), not first


def _close_window(learner: Learner, state: State) -> State:
    """Take in the window that the newest pose completes, if there is one."""
    earliest = samples.first_start(state.recent)
    start = max(state.start, earliest)
    if not np.isfinite(start) or state.recent.newest < start + samples.WINDOW + samples.LATE:
        return replace(state, start=state.start if state.start > earliest else -np.inf)
    run = samples.make_window(state.recent, start)
    state = replace(state, start=start + samples.WINDOW)
    return state if run is None else take_window(learner, state, start, run)


def take_window(learner: Learner, state: State, t: float, run: Run) -> State:
    """The state after one more window that began at `t` [s]."""
    state = replace(state, seen=state.seen + 1)
    if state.known is None:
        return _learn(learner, replace(state, windows=(*state.windows, (t, run))))
    if state.change is not None:
        change = replace(state.change, windows=(*state.change.windows, (t, run)))
        if len(change.windows) in LOOKS:
            change = judge(state.known, change)
        return _after(learner, state, state.known, change)
    seen = tracking.look(state.known.reference, run, t)
    if seen is None:
        return state
    windows = (*state.windows, (t, run))[-SPANS[-1] :]
    return _watch(learner, replace(state, windows=windows), state.known, seen)


def _learn(learner: Learner, state: State) -> State:
    """Learn the car once there are windows enough."""
    if len(state.windows) < REFERENCE:
        return state
    known = learn(learner.augmented, state.windows, learner.noise, learner.remembered)
    kept = state.windows[-SPANS[-1] :] if known else state.windows[REFERENCE // 2 :]
    return replace(state, windows=kept, known=known)


def _watch(learner: Learner, state: State, known: Known, seen: Loss) -> State:
    """A window while nothing is the matter; a change is called where it does not fit."""
    known = replace(known, seen=(*known.seen, Seen(known.track, seen))[-SPANS[-1] :])
    table, level = ratios(known.reference, known.seen), known.usual.level()
    table = reweighted(known.reference, known.seen, table, level)
    judged = table / level
    worst = float(np.nanmax(judged))
    if worst >= ALARM:
        return _call(learner, state, known, SPANS[int(np.nanargmax(judged)) % len(SPANS)])
    n = known.reference.space.nuisance
    track, shown = known.track, known.shown
    if worst < DOUBT:
        track = tracking.follow(track, seen.weight * seen.g[:n], seen.weight * seen.h[:n, :n])
    shown, usual = (*shown, table), known.usual
    if len(shown) > DELAY:
        usual = usual.after(shown[0], FADING)
        shown = shown[1:]
    known = replace(known, track=track, usual=usual, shown=shown, peak=max(known.peak, worst))
    return replace(state, known=known)


def _call(learner: Learner, state: State, known: Known, span: int) -> State:
    """Call a change that began `span` windows ago."""
    (before, first), (_, last) = known.seen[-span], known.seen[-1]
    noticed = last.t + samples.WINDOW + samples.LATE
    change = Change(first.t, noticed, before, state.windows[-span:])
    # What was followed since the change is taken back.
    known = replace(known, track=before, shown=())
    if span >= LOOKS[0]:
        change = judge(known, change)
    return _after(learner, state, known, change)


def judge(known: Known, change: Change) -> Change:
    """A change with what its windows say."""
    runs = [run for _, run in change.windows]
    finding = find_cause(known.reference, change.before, runs)
    if finding.cause is None:
        return replace(change, finding=finding)
    was = known.reference.augmented.values(finding.cause.effect)
    alone = not finding.cause.ambiguous_with and len(runs) >= SETTLED
    proven = (finding.cause, was) if alone else change.proven
    return replace(change, finding=finding, was=was, proven=proven)


def _after(learner: Learner, state: State, known: Known, change: Change) -> State:
    """The change kept, taken back where there was none, or the car learnt anew after it."""
    windows = change.windows
    if change.finding.verdict == "none":
        kept = replace(known, seen=())
        return replace(state, known=kept, change=None, taken_back=state.taken_back + 1, windows=())
    if len(windows) < REFERENCE + 1:
        return replace(state, known=known, change=change)
    # The first window may hold the change itself.
    again = learn(learner.augmented, windows[1:], learner.noise)
    if again is None:
        return replace(state, change=replace(change, windows=windows[REFERENCE // 2 :]))
    past = (*state.past, replace(change, windows=()))
    return replace(state, known=again, change=None, past=past, windows=windows[-SPANS[-1] :])
