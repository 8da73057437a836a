"""What changed: the diagnosis that `diagnose` makes, of the last seconds of driving.

The base is the car as it was learnt before the change, its uncertainty what the drive left of it;
windows, likelihood, hypotheses and verdict are those of `steerd.sysid.inference`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from steerd.sim_gap.online.looking import Anchor, anchored, may_change, open_windows
from steerd.sim_gap.online.tracking import Track
from steerd.sim_gap.verdict.evidence import Cause, Verdict, judge_case
from steerd.sysid.data.dataset import Run
from steerd.sysid.inference.hypotheses import Library, explain
from steerd.sysid.inference.knowledge import Knowledge
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.superset import Superset

LOOKS = (5, 6, 8, 11, 16, 21, 27, 34, 42, 50)
"""Windows after a change at which they are diagnosed: each time costs a third of a second."""
LATEST = 30
"""No more windows than these are diagnosed, the newest: what came slowly is over in them."""
EARLY = 8
"""Before so many windows it is too early to say that nothing explains a change, or that there was
none."""


@dataclass(frozen=True)
class Finding:
    """What is said of a change.

    Attributes:
        verdict: `changed` (too early to say), `named`, `unexplained` or `none`.
        cause: the effect, where it is named.
        sure: probability that it, or one that it is ambiguous with, is the cause.
    """

    verdict: str = "changed"
    cause: Cause | None = None
    sure: float = 0.0


def find_cause(anchor: Anchor, before: Track, windows: Sequence[Run]) -> Finding:
    """What the windows since a change say of it.

    Args:
        anchor: the car.
        before: what was known of the base before the change.
        windows: since then; the first may hold the change itself and is left out.
    """
    try:
        verdict = _diagnose(believed(anchor, before), anchor, windows[1:][-LATEST:])
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return Finding()
    if verdict.causes:
        return Finding("named", verdict.causes[0], 1.0 - verdict.something_else)
    if len(windows) < EARLY:
        return Finding()
    return Finding("none" if verdict.name == "none" else "unexplained")


def believed(anchor: Anchor, track: Track) -> Superset:
    """The anchor's car with what was learnt about it: the same drive, so no wider."""
    space = anchor.space
    n, z = space.nuisance, space.centre.copy()
    z[:n] += track.mean
    learnt = anchored(anchor.superset, space.chart.parameters(z))
    known = Knowledge(space.chart.free[:n], track.covariance)
    if learnt.knowledge is not None:
        known = replace(known, excess=learnt.knowledge.excess)
    return replace(learnt, knowledge=known)


def _diagnose(base: Superset, anchor: Anchor, runs: Sequence[Run]) -> Verdict:
    """The verdict on windows.

    Raises:
        ValueError: no window sees enough poses.
        FloatingPointError: the base's simulation leaves the map.
    """
    engine = open_windows(base, runs, anchor.late)
    guess = engine.readings.layout.guess.copy()
    likelihood = make_likelihood(engine, base.base, guess, anchor.noise)
    possible = may_change(base, runs)
    effects = tuple(e for e in base.effects if e.name in possible)
    nuisance = anchor.space.chart.free[: anchor.space.nuisance]
    library = Library(likelihood, nuisance, effects)
    return judge_case(library, explain(library, 1), known=True)
