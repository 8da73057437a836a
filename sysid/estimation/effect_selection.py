"""A car's own effects: which of the library its drives show, decided by their likelihood.

Real cars are no straight lines: tyres level off, linkages bend, have play and turn further to one
side, a mocap body is mounted askew. Which of these a car has is found step by step: each candidate
is fitted on top of what was taken so far, with all other free parameters; the one that helps most
is taken if windows all over the drives agree that it helps, and the search ends when none does.
One compiled car holds all candidates: at its null an effect changes nothing.
"""

# Why: docs/decisions/identification.md#d47

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.effect import BaseSelection, Effect
from steerd.car_model.effects import EFFECTS, find_effect
from steerd.car_model.model import Model
from steerd.sysid.compiler.kernels import (
    Kernels,
    delays_of,
    make_kernels,
    model_of,
    parameter_vector,
)
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import Layout, make_layout, speed_range
from steerd.sysid.estimation.chart import make_chart
from steerd.sysid.estimation.fit import Fit, Options, residual_noise
from steerd.sysid.estimation.levenberg_marquardt import Effort, minimise
from steerd.sysid.estimation.objective import (
    Problem,
    cost_of,
    normal_equations,
    robust_limit,
    solve,
)

Array = NDArray[np.float64]

CANDIDATES: tuple[str, ...] = tuple(
    effect.name
    for effect in EFFECTS.values()
    if effect.selectable_in_base is BaseSelection.IDENTIFY
)
"""Effects that any car may have and that no parameter of the base equations stands for."""
HORIZON = 1.0
"""Length of the windows [s]."""
SECONDS = 240.0
"""Windows of this much driving are enough to choose by [s]."""
READINGS = 20.0
"""So many of a window's readings count: errors of a model are correlated."""
GAIN = 8.0
"""An effect that gains less log-likelihood is not taken."""
GAIN_SE = 2.0
"""Nor one whose gain is not so many times its standard error over the windows."""
_LEFT = 0.02
"""An effect within this share of its ordinary size from its null was not needed."""
_ESCAPES = 6
"""So often a search may begin a round again from a better point."""
_TRIAL = Effort(8, 0.5, 1e-3, 1e-3, patient=True)
_SETTLE = Effort(20, 0.3, 1e-3, 1e-3, patient=True)


class Step(NamedTuple):
    """One effect that was taken.

    Attributes:
        effect: its name.
        gain: log-likelihood that it gained.
        se: standard error of that over the windows.
    """

    effect: str
    gain: float
    se: float


@dataclass(frozen=True)
class Selection:
    """What was chosen.

    Attributes:
        model: the car with the effects, at the values found: a start for the fit.
        free: names of the effects' parameters.
        steps: the effects in the order in which they were taken.
    """

    model: Model[float]
    free: tuple[str, ...]
    steps: tuple[Step, ...]

    def with_nulls(self, model: Model[float]) -> Model[float]:
        """Another car with the same effects, the new ones at their nulls."""
        own = dict(zip((e.name for e in model.effects), model.values, strict=True))
        effects = self.model.effects
        return model._replace(
            effects=effects, values=tuple(own.get(e.name, e.nulls) for e in effects)
        )


class _Point(NamedTuple):
    """A fitted choice: which effects, where, and each window's loss."""

    taken: tuple[str, ...]
    parameters: Array
    x: Array
    losses: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class _Search:
    """What all trials share: one compiled car with every candidate in it."""

    kernels: Kernels
    layout: Layout
    sigma: Array
    speeds: tuple[float, float]
    prior: Array
    free: tuple[str, ...]
    options: Options

    def names(self, effect: str) -> tuple[str, ...]:
        return tuple(n for n in self.kernels.names if n.startswith(f"{effect}."))

    def problem(self, taken: Sequence[str]) -> Problem:
        """The windows, with the base's and the taken effects' parameters free."""
        free = (*self.free, *(name for effect in taken for name in self.names(effect)))
        chart = make_chart(self.kernels.effects, self.prior, free, self.options.wheelbase)
        return Problem(
            self.kernels, chart, self.layout, self.sigma, self.speeds,
            self.options.integrator, self.options.substeps,
        )  # fmt: skip

    def losses(self, error: Array) -> Array:
        """(W,) loss of each window: Student's t, so that one that spins decides nothing."""
        bounds = self.layout.bounds
        square = np.add.reduceat(error**2, bounds[:-1]) / np.diff(bounds)
        loss: Array = 0.5 * READINGS * np.log1p(square)
        return loss

    def fit(self, taken: tuple[str, ...], start: _Point, effort: Effort) -> _Point:
        """The best parameters for these effects from a start."""
        problem = self.problem(taken)
        chart = problem.chart
        low, high = chart.bounds()
        z = np.clip(chart.coordinates(start.parameters), low, high)
        found = minimise(problem, z, start.x, effort)
        losses, noise = self.losses(found.at.error), residual_noise(problem, found)
        return _Point(taken, chart.parameters(found.z), found.x, losses, noise)

    def switch_on(self, effect: Effect, start: _Point) -> _Point:
        """The start with the effect switched on where its null has no slope, or is a bound.

        The best of the scan values, or the ordinary size of what cannot be negative.
        """
        tries = []
        for name, p in zip(self.names(effect.name), effect.parameters, strict=True):
            for value in p.scan or ((p.null + p.scale,) if p.low == p.null else ()):
                moved = start.parameters.copy()
                moved[self.kernels.names.index(name)] = value
                tries.append(moved)
        if len(tries) > 1:
            problem = self.problem(start.taken)
            tries.sort(key=lambda p: self._rough(problem, p, start))
        return start._replace(parameters=tries[0]) if tries else start

    def is_used(self, effect: Effect, point: _Point) -> bool:
        """Whether an effect ended away from its null."""
        values = (point.parameters[self.kernels.names.index(n)] for n in self.names(effect.name))
        return any(
            abs(value - p.null) > _LEFT * p.scale
            for value, p in zip(values, effect.parameters, strict=True)
        )

    def _rough(self, problem: Problem, parameters: Array, start: _Point) -> float:
        """Cost at given parameters after one step of the initial states."""
        chart = replace(problem.chart, prior=parameters)
        moved = replace(problem, chart=chart, _stations={})
        z = chart.coordinates(parameters)
        at = moved.evaluate(z, start.x)
        limit = robust_limit(at.error)
        dx = solve(normal_equations(moved, at, limit), 0.0, np.ones(len(z), bool))[1]
        return cost_of(moved.evaluate(z, start.x + dx), limit)


def select_effects(
    runs: Sequence[Run], rough: Fit, options: Options, names: Sequence[str] = CANDIDATES
) -> Selection:
    """Which effects the drives show, with start values for them and the car.

    Args:
        runs: parts of drives, see `cut.moving_segments`.
        rough: the car without further effects, fitted on windows of this length.
        options: of the fit; `free` names the base's free parameters.
        names: candidates.
    """
    search, point = _start_search(runs, rough, options, names)
    steps: list[Step] = []
    escapes = _ESCAPES
    while True:
        point = search.fit(point.taken, point, _SETTLE)
        # Errors in units of what is left of them: of those at the start, none would be seen later.
        search = replace(search, sigma=point.noise)
        point = search.fit(point.taken, point, _SETTLE)
        tried = _try_each(search, point, [n for n in names if n not in point.taken])
        better = _escape(search, point, tried) if escapes else None
        if better is not None:
            point, escapes = better, escapes - 1
            continue
        best = _best(search, point, tried)
        if best is None:
            break
        steps.append(Step(best.taken[-1], *_gain(point.losses - best.losses)))
        point = best
    point = _drop_idle(search, point)
    kept = tuple(step for step in steps if step.effect in point.taken)
    return _make_selection(search, rough, point, kept)


def _drop_idle(search: _Search, point: _Point) -> _Point:
    """The point without effects that later ones have made idle."""
    for name in point.taken:
        effect = find_effect(name)
        bare = point.parameters.copy()
        bare[[search.kernels.names.index(n) for n in search.names(name)]] = effect.nulls
        left = tuple(each for each in point.taken if each != name)
        with suppress(FloatingPointError):
            without = search.fit(left, point._replace(parameters=bare), _TRIAL)
            if float((without.losses - point.losses).sum()) < GAIN:
                point = without
    return point


def _start_search(
    runs: Sequence[Run], rough: Fit, options: Options, names: Sequence[str]
) -> tuple[_Search, _Point]:
    own = rough.model.effects
    extra = tuple(find_effect(n) for n in names if n not in {e.name for e in own})
    model = rough.model._replace(
        effects=(*own, *extra), values=(*rough.model.values, *(e.nulls for e in extra))
    )
    kernels, prior = make_kernels(model.effects, model.chassis), parameter_vector(model)
    late = float(delays_of(kernels, prior)[2])
    layout = make_layout(runs, HORIZON, late, SECONDS)
    search = _Search(
        kernels, layout, rough.noise, speed_range(runs), prior, rough.chart.free, options
    )
    return search, _Point((), prior, layout.guess.copy(), np.empty(0), rough.noise)


def _gain(gained: Array) -> tuple[float, float]:
    """Sum over the windows and its standard error."""
    return float(gained.sum()), float(np.sqrt(len(gained)) * gained.std())


def _try_each(search: _Search, point: _Point, names: Sequence[str]) -> list[_Point]:
    """Every candidate on top of a point; one that sends the simulation off is left out."""
    found: list[_Point] = []
    for name in names:
        start = search.switch_on(find_effect(name), point)
        with suppress(FloatingPointError):
            found.append(search.fit((*point.taken, name), start, _TRIAL))
    return found


def _escape(search: _Search, point: _Point, tried: Sequence[_Point]) -> _Point | None:
    """A better point without any candidate: where the fit had stuck, at a kink of play say.

    A candidate that ends at its null and yet gains has only moved the others.
    """
    idle = [
        t for t in tried if not search.is_used(find_effect(t.taken[-1]), t) and _gains(point, t)
    ]
    if not idle:
        return None
    return min(idle, key=lambda t: float(t.losses.sum()))._replace(taken=point.taken)


def _gains(point: _Point, tried: _Point) -> bool:
    gain, se = _gain(point.losses - tried.losses)
    return gain >= GAIN and gain >= GAIN_SE * se


def _best(search: _Search, point: _Point, tried: Sequence[_Point]) -> _Point | None:
    """The candidate that gains most, if it gains enough; of equals, the one that says least."""
    found = [t for t in tried if search.is_used(find_effect(t.taken[-1]), t) and _gains(point, t)]
    if not found:
        return None
    best = min(found, key=lambda tried: float(tried.losses.sum()))
    equals = [tried for tried in found if _behind(tried, best)]
    return min(equals, key=lambda t: (len(search.names(t.taken[-1])), float(t.losses.sum())))


def _behind(tried: _Point, best: _Point) -> bool:
    """Whether a candidate lies behind the best by no more than chance would have it."""
    gap, se = _gain(tried.losses - best.losses)
    return gap <= se


def _make_selection(search: _Search, rough: Fit, point: _Point, steps: Sequence[Step]) -> Selection:
    """The car with the taken effects alone."""
    full = model_of(search.kernels, point.parameters)
    own = {e.name for e in rough.model.effects}
    kept = [
        (effect, values)
        for effect, values in zip(full.effects, full.values, strict=True)
        if effect.name in own or effect.name in point.taken
    ]
    model = Model(full.car, tuple(e for e, _ in kept), tuple(v for _, v in kept), full.chassis)
    free = tuple(name for effect in point.taken for name in search.names(effect))
    return Selection(model, free, tuple(steps))
