"""What to drive next: of a menu, the manoeuvre that best distinguishes two suspects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from steerd.car_model.model import observe
from steerd.car_model.native import windows as compiled
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.state import ORIGIN, State
from steerd.sim_gap.verdict.where import Fits
from steerd.sysid.data.data_checks import Array
from steerd.sysid.data.dataset import GRID, NOTHING, Run, Signal
from steerd.sysid.inference.chart import places_of
from steerd.sysid.inference.library import Library, carry
from steerd.sysid.inference.likelihood import Likelihood, make_likelihood
from steerd.sysid.inference.predictor import open_predictor
from steerd.sysid.inference.residuals import settled
from steerd.sysid.inference.search import Point, curvature, stand

SECONDS = 8.0
_SUBSTEPS = 4


@dataclass(frozen=True)
class Manoeuvre:
    """A drive worth making."""

    name: str  # from the menu; `how` says it in words
    how: str
    command: str  # drives it
    separates: tuple[str, str]  # the two suspects
    expected_nats: float  # expected log-likelihood by which the wrong one falls behind
    now_nats: float  # the same of as many seconds of the present drives


def _square(t: Array, period: float) -> Array:
    return np.where((t / period) % 1.0 < 0.5, 1.0, -1.0)


class _Drive(NamedTuple):
    """A manoeuvre in words, the command that drives it, and its steering and speed by time."""

    how: str
    command: str
    drive: Callable[[Array], tuple[Array, Array]]


MENU: Mapping[str, _Drive] = {
    "step steers": _Drive(
        "steps of the steering about both sides' circles at up to 2 m/s",
        "steerd collect --plan steps --speed 2",
        lambda t: (0.14 + 0.1 * _square(t, 2.0), np.where(t < SECONDS / 2, 1.2, 2.0)),
    ),
    "speed steps": _Drive(
        "steps of the speed on circles to both sides, between 1 and 2.5 m/s",
        "steerd collect --plan speeds --speed 2.5",
        lambda t: (0.15 + 0.0 * t, 1.75 + 0.75 * _square(t, 2.5)),
    ),
    "ramp to the limit": _Drive(
        "tight circles to both sides while the speed grows to 2 m/s",
        "steerd collect --plan ramp --speed 2",
        lambda t: (0.23 + 0.0 * t, 0.8 + 1.2 * t / SECONDS),
    ),
    "figure of eight": _Drive(
        "figures of eight at 2 m/s, once along and once across the hall",
        "steerd run --path figure8 --speed 2",
        lambda t: (0.25 * np.sin(2.0 * np.pi * t / 4.0), 2.0 + 0.0 * t),
    ),
    "chirp": _Drive(
        "steering from 0.3 to 4 Hz about both sides' circles at 2 m/s",
        "steerd collect --plan chirp --speed 2",
        lambda t: (0.14 + 0.1 * np.sin(2.0 * np.pi * (0.3 + 0.2 * t) * t), 2.0 + 0.0 * t),
    ),
}
"""Within the limits that a car file has at first: 3 m/s^2 sideways. The plans are driven by
`daemon/assembly/plans.py`; a test holds both together."""


def _drive(fits: Fits, name: str) -> Run:
    """The manoeuvre as the explained car would drive it, read by the same instruments."""
    kernels, parameters = fits.predictor.augmented.kernels, fits.after.parameters
    t = GRID * np.arange(round(SECONDS / GRID), dtype=float)
    rows = np.column_stack(MENU[name].drive(t))
    first = np.zeros((1, compiled.STATES + kernels.memory))
    first[0, : compiled.STATES] = ORIGIN._replace(steer=rows[0, 0], speed=rows[0, 1])
    held = compiled.HeldCommands(rows, GRID, _SUBSTEPS)
    blocks = compiled.make_window_blocks(np.array([[0, len(t), 0]]), np.zeros(1))
    path = compiled.march(kernels, parameters, first, held, blocks, len(t) * _SUBSTEPS)
    path = compiled.view_by_window(path, 1)[0, :-1:_SUBSTEPS, : compiled.STATES]
    *pose, wheel, rate = observe(NUMPY, compiled.model_of(kernels, parameters), State(*path.T))
    seen = Signal(t + compiled.delays_of(kernels, parameters)[2], np.column_stack(pose))
    read = fits.predictor.layout.channel
    rolled, turned = (Signal(t, v) if k in read else NOTHING for k, v in ((3, wheel), (4, rate)))
    return Run(name, GRID, rows, seen, wheel=rolled, yaw_rate=turned)


def margin(
    likelihood: Likelihood, point: Point, nuisance: Sequence[str], pair: tuple[str, str]
) -> float:
    """Expected lead of the first over the second suspect on these windows [nats].

    Half the square of the first's effect on the readings, less what the second can make of it (the
    largest canonical correlation of both, the base eliminated).
    """
    augmented = likelihood.predictor.augmented
    names = [*point.space.effects, *(n for n in pair if n not in point.space.effects)]
    space = Library(likelihood, tuple(nuisance), (), known=False).space(names)
    at = stand(likelihood, space, z := carry(likelihood, space, point), point.x, 0.0).at
    # A drive will have noise: what is closer than that is no surer.
    at = at._replace(square=np.maximum(at.square, at.dof))
    h, n = curvature(space, at), space.nuisance
    s = h[n:, n:] - h[n:, :n] @ np.linalg.solve(h[:n, :n], h[:n, n:])
    free = space.chart.free[n:]
    mine, theirs = (places_of(free, name) for name in pair)
    size = z[n:][mine] - np.array(augmented.values(pair[0]))
    cross = s[np.ix_(mine, theirs)]
    left = np.linalg.solve(s[np.ix_(mine, mine)], cross)
    right = np.linalg.solve(s[np.ix_(theirs, theirs)], cross.T)
    alike = float(np.clip(np.max(np.real(np.linalg.eigvals(left @ right))), 0.0, 1.0))
    return 0.5 * float(size @ s[np.ix_(mine, mine)] @ size) * (1.0 - alike)


def next_manoeuvre(fits: Fits, nuisance: Sequence[str], pair: tuple[str, str]) -> Manoeuvre | None:
    """The manoeuvre of the menu with the largest expected lead, None if all diverge."""
    layout = fits.predictor.layout
    seconds = float((layout.spans[:, 3] * layout.h).sum())
    try:
        now = margin(fits.likelihood, fits.after, nuisance, pair) * SECONDS / max(seconds, 1e-9)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None
    best: Manoeuvre | None = None
    for name, drive in MENU.items():
        try:
            gained = margin(*_on(fits, name), nuisance, pair)
        except (FloatingPointError, OverflowError, ValueError, np.linalg.LinAlgError):
            continue
        if best is None or gained > best.expected_nats:
            best = Manoeuvre(name, drive.how, drive.command, pair, gained, now)
    return best


def _on(fits: Fits, name: str) -> tuple[Likelihood, Point]:
    """The windows and the hypothesis of a manoeuvre not driven yet."""
    augmented, point = fits.predictor.augmented, fits.after
    other = open_predictor(augmented, [_drive(fits, name)])
    likelihood = make_likelihood(other, point.parameters, other.guess, fits.noise)
    return likelihood, settled(likelihood, point.space, point.z)
