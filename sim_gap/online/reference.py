"""The car as it is at first: base and noise at their best on the first windows of a drive."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from steerd.sim_gap.online.looking import (
    Anchor,
    Look,
    anchored,
    looks_of,
    make_anchor,
    may_change,
    open_windows,
)
from steerd.sim_gap.online.tracking import Track
from steerd.sysid.data.dataset import Run
from steerd.sysid.data.windows import estimate_noise
from steerd.sysid.inference.hypotheses import Library, begin
from steerd.sysid.inference.likelihood import make_likelihood
from steerd.sysid.inference.noise import Noise, learn_noise, usual_noise
from steerd.sysid.inference.search import minimise, stand
from steerd.sysid.inference.space import nuisance_names
from steerd.sysid.inference.superset import Superset


class Reference(NamedTuple):
    """A car learnt from windows: the anchor, what is known about it, and the windows seen."""

    anchor: Anchor
    track: Track
    looks: tuple[Look, ...]


def learn_reference(
    superset: Superset, runs: Sequence[Run], times: Sequence[float], noise: Noise | None
) -> Reference | None:
    """Learn base and noise from windows.

    Args:
        superset: the car file's base.
        runs: the windows.
        times: when each began [s].
        noise: as the car file knows it.

    Returns:
        None where the base's simulation leaves the map.
    """
    nuisance = nuisance_names(superset, runs)
    known = {name.partition(".")[0] for name in nuisance if "." in name}
    built_in = tuple(e.name for e in superset.effects if e.on_every_car and e.name not in known)
    late = float(superset.base[superset.kernels.names.index("pose_delay")])
    try:
        engine = open_windows(superset, runs, late)
        x = engine.readings.layout.guess.copy()
        rough = noise or usual_noise(estimate_noise(runs))
        likelihood = make_likelihood(engine, superset.base, x, rough)
        library = Library(likelihood, nuisance, (), known=False)
        fitted = minimise(likelihood, begin(library, built_in, (), x))
        noise = learn_noise(engine, fitted, noise)
        likelihood = make_likelihood(engine, fitted.parameters, fitted.x, noise)
        begun = stand(likelihood, fitted.space, fitted.z, fitted.x, fitted.size)
        fitted = minimise(likelihood, begun)
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None
    learnt = anchored(superset, fitted.parameters)
    flat = {e.name for e in superset.effects if e.zero_gradient}
    sloped = [name for name in may_change(learnt, runs) if name not in flat]
    anchor = make_anchor(learnt, nuisance, sloped, noise)
    try:
        at = stand(likelihood, anchor.space, anchor.space.centre, fitted.x, 0.0).at
    except FloatingPointError:
        return None
    looks = looks_of(at, times)
    n = anchor.space.nuisance
    prior = np.asarray(np.linalg.inv(anchor.space.covariance[:n, :n]), np.float64)
    informed = sum((seen.weight * seen.h[:n, :n] for seen in looks), np.zeros((n, n)))
    # The windows made the anchor: about it they pull nowhere.
    return Reference(anchor, Track(prior + informed, np.zeros(n), prior), tuple(looks))
