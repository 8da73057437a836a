"""Where the gap lies: which equation, channel, stretch of time and kind of driving."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from steerd.sysid.data.data_checks import Array, Indices
from steerd.sysid.inference import residuals
from steerd.sysid.inference.disturbance_response import INPUTS, responses
from steerd.sysid.inference.likelihood import Likelihood
from steerd.sysid.inference.noise import Noise, covariance, likeliest_sizes, shapes
from steerd.sysid.inference.predictor import Predictor
from steerd.sysid.inference.residuals import Gap, interval_of, middle_of, robust_mean
from steerd.sysid.inference.search import Point

EQUATIONS = {
    "accel": "longitudinal equation", "lateral": "side-slip equation", "yaw": "yaw equation",
    "steer": "steering actuator", "drive": "drive actuator",
}  # fmt: skip
CHANNELS: tuple[str, ...] = ("x", "y", "yaw", "wheel_speed", "yaw_rate")
_VARIABLES = {
    "speed": ("m/s", 0.2), "lateral_acceleration": ("m/s^2", 0.5), "steering_rate": ("rad/s", 0.1),
    "longitudinal_acceleration": ("m/s^2", 0.3), "x": ("m", 0.5), "y": ("m", 0.5),
    "heading": ("rad", 0.5), "run_time": ("s", 5.0),
}  # fmt: skip
"""Unit, and what a variable must spread over (5th to 95th percentile) before anything is said of
its bins."""
_WORTH_NAMING = 1.5  # lower end of a regime's ratio before the sentence names it
BIN_LEAST = 8
_BINS = 3
_SIZES = np.array([0.3, 0.3, 3.0, 0.01, 0.1])  # where the search for hidden inputs starts
_WINDOWS = 50  # that are enough for it
FEW = 0.1  # share of the windows that are few
MOST = 0.5  # share of the excess error that is most of it
_LIKE = 0.2  # what has more than this share of the worst window's excess belongs to it
_LISTED = 3  # moments that are listed
_NEAR = 2.5  # windows this near to each other are at one place [m]
_HUGE = 1e3  # a window that spun counts no more than this often


@dataclass(frozen=True, eq=False)
class Fits:
    """The base and its explanation on the same windows, and what they are judged by."""

    likelihood: Likelihood  # the windows
    before: Point  # the base alone; `after`: with the explanation
    after: Point
    noise: Noise  # what is taken as random; `floor`: what it leaves of the whitened error
    floor: float
    names: Sequence[str]  # of the drives

    @property
    def predictor(self) -> Predictor:
        """The windows."""
        return self.likelihood.predictor

    @property
    def blocks(self) -> Indices:
        """(W,) windows that follow each other."""
        return residuals.blocks_of(self.predictor)

    @property
    def values(self) -> dict[str, tuple[float, ...]]:
        """Parameters of the explanation's effects."""
        places, at = self.predictor.augmented.places, self.after.parameters
        return {e: tuple(at[places(e)].tolist()) for e in self.after.space.effects}

    def gaps(self, leads: Sequence[float] = residuals.LEADS) -> list[Gap]:
        """The gaps of both."""
        spun, both = residuals.spun_windows(self.after), (self.before, self.after)
        return [residuals.gap_of(self.predictor, fit, spun, leads) for fit in both]


@dataclass(frozen=True)
class Share:
    """A part of the gap: its name and how much of the whole lies there (0 to 1)."""

    name: str
    share: float


@dataclass(frozen=True)
class Stretch:
    """An interval of a run in which the gap is larger than elsewhere."""

    run: str
    t0: float
    t1: float
    share: float


@dataclass(frozen=True)
class Regime:
    """A kind of driving."""

    variable: str  # what is binned; `unit` of it
    low: float  # where the bin begins; high: where it ends
    high: float
    # Whitened error within it against elsewhere; `ratio_low` and `ratio_high` its 90 % interval
    ratio: float
    share: float  # part of the excess error that lies in it
    ratio_low: float
    ratio_high: float
    unit: str


@dataclass(frozen=True)
class Where:
    """The whole localisation; `sentence` says it in words."""

    stage: str
    equation: tuple[Share, ...]
    channels: tuple[Share, ...]
    windows: tuple[Stretch, ...]
    regimes: tuple[Regime, ...]
    sentence: str


def equation_shares(fits: Fits) -> tuple[Share, ...]:
    """Share of the removable error that hidden inputs to each equation would take away.

    Each of the five inputs gets a variance of its own by maximum likelihood (automatic relevance
    determination); inputs that explain nothing go to zero.
    """
    predictor, fitted = fits.predictor, fits.before
    seen, error = responses(predictor, fitted.parameters, fitted.x), fitted.linear.error
    known, shaped = covariance(predictor, fits.noise, seen[:3], error), shapes(seen)
    error, by_starts = predictor.about_guess(fitted.x, fitted.linear)
    known += by_starts
    some = np.unique(np.linspace(0, len(error) - 1, _WINDOWS).round().astype(int))
    there = predictor.padded.there[some]
    parts = error[some], known[some], np.empty((0, *there.shape)), [v[some] for v in shaped], there
    sizes = likeliest_sizes(_SIZES, (_SIZES * 1e-3, _SIZES * 1e2), parts) ** 2
    cov = known + sum(s * v for s, v in zip(sizes, shaped, strict=True))
    pulled = np.linalg.solve(cov, error[:, :, None])[:, :, 0]
    taken = sizes * [np.einsum("wi,wij,wj->", pulled, v, pulled) for v in shaped]
    shares = taken / max(float(taken.sum()), 1e-12)
    return tuple(Share(INPUTS[i], float(shares[i])) for i in np.argsort(-shares))


def channel_shares(fits: Fits) -> tuple[Share, ...]:
    """Share of each channel in what the explanation removes."""
    precision, channel = fits.likelihood.precision, fits.predictor.channel
    before, after = (fit.linear.error**2 * precision for fit in (fits.before, fits.after))
    removed = before - after
    parts = np.array([removed[channel == c].clip(-1e4, 1e4).sum() for c in range(5)]).clip(0.0)
    whole = max(float(parts.sum()), 1e-12)
    shares = [Share(name, float(p / whole)) for name, p in zip(CHANNELS, parts, strict=True)]
    return tuple(sorted(shares, key=lambda s: -s.share))


def conditions(predictor: Predictor, fitted: Point) -> dict[str, Array]:
    """What the car was doing in each window (W,), by variable."""
    layout = predictor.layout
    x, spans = fitted.x, layout.spans
    rate, acc = np.empty(len(x)), np.empty(len(x))
    for w, (_, _, first, steps, _) in enumerate(spans):
        part = layout.commands[first : first + steps]
        rate[w] = np.abs(np.diff(part[:, 0])).sum() / (steps * layout.h)
        acc[w] = np.abs(part[-1, 1] - x[w, 3]) / (steps * layout.h)
    return {
        "speed": predictor.pace, "lateral_acceleration": predictor.lateral, "steering_rate": rate,
        "longitudinal_acceleration": acc, "x": x[:, 0], "y": x[:, 1],
        "heading": (x[:, 2] + np.pi) % (2.0 * np.pi) - np.pi, "run_time": layout.t,
    }  # fmt: skip


def regimes(fits: Fits) -> tuple[Regime, ...]:
    """Bins of every variable in which the error differs from elsewhere, strongest first."""
    each, blocks, found = fits.before.at.ratio, fits.blocks, []
    excess = np.maximum(np.minimum(each, 100.0) - 1.0, 0.0)
    for name, values in conditions(fits.predictor, fits.before).items():
        unit, least = _VARIABLES[name]
        if np.subtract(*np.quantile(values, [0.95, 0.05])) < least:
            continue
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
        for low, high in pairwise(edges):
            inside = (values >= low) & ((values < high) | (high == edges[-1]))
            if min(inside.sum(), (~inside).sum()) < BIN_LEAST:
                continue
            draws = interval_of(each[inside], blocks[inside]) / interval_of(
                each[~inside], blocks[~inside], 1
            )
            ratio = robust_mean(each[inside]) / max(robust_mean(each[~inside]), 1e-9)
            share, ends = float(excess[inside].sum() / max(excess.sum(), 1e-9)), middle_of(draws)
            found.append(Regime(name, float(low), float(high), float(ratio), share, *ends, unit))
    return tuple(sorted(found, key=lambda r: -r.ratio_low))


def stretches(fits: Fits) -> tuple[Stretch, ...]:
    """Stretches in which the error stands out: windows above two medians, neighbours merged."""
    layout, each = fits.predictor.layout, np.minimum(fits.before.at.ratio, 1e3)
    excess = np.maximum(each - 1.0, 0.0)
    bad = each > max(2.0 * float(np.median(each)), 1.5)
    found: list[Stretch] = []
    for (stands_out, run), group in groupby(range(len(each)), lambda w: (bad[w], layout.run[w])):
        if stands_out:
            mine = list(group)
            stop = layout.t[mine[-1]] + layout.spans[mine[-1], 3] * layout.h
            share = float(excess[mine].sum() / max(excess.sum(), 1e-9))
            found.append(Stretch(fits.names[run], float(layout.t[mine[0]]), float(stop), share))
    return tuple(sorted(found, key=lambda s: -s.share)[:12])


def range_words(regime: Regime) -> str:
    """From where to where, with the digits that distinguish the two: "1.98 to 2.02 m/s"."""
    scale, unit = (math.degrees(1.0), "°") if regime.unit == "rad" else (1.0, f" {regime.unit}")
    low, high = scale * regime.low, scale * regime.high
    span = high - low
    places = min(max(1 - math.floor(math.log10(max(span, 1e-4))), 0), 4) if span < 10.0 else 0
    first, last = (f"{round(end, places) + 0.0:.{places}f}" for end in (low, high))  # no "-0.0"
    text = f"{first} to {last}" if first != last else f"{low:.3g}"
    return f"{text}{unit.replace('^2', '²')}"


def sentence_of(equation: Sequence[Share], found: Sequence[Regime], moments: str = "") -> str:
    """The localisation in one sentence; `moments` says which few windows hold most of it."""
    most = equation[0]
    text = f"The error lies in the {EQUATIONS[most.name]} ({most.share:.0%} of what hidden inputs"
    text += " would remove)"
    if moments:
        return f"{text}; {moments}."
    if not found or found[0].ratio_low <= _WORTH_NAMING:
        return f"{text}; it is much the same at every speed, place and time."
    r = found[0]
    name = r.variable.replace("_", " ")
    return (
        f"{text}; it is {r.ratio:.1f} times as large when {name} is {range_words(r)} as elsewhere."
    )


def find_moments(ratios: Array) -> Indices:
    """Windows, the worst first, that hold most of the excess though they are few; else none.

    A place passed once, a bump, a second in which the car spun: held-out drives cannot confirm what
    shows in one of them alone, so no effect is named for it; when and where it was is what a reader
    can look at, and drive again. The ratios (W,) are squared errors by what noise leaves.
    """
    excess = np.clip(ratios - 1.0, 0.0, _HUGE)
    order = np.argsort(-excess, kind="stable")
    worst: Indices = order[excess[order] > _LIKE * excess.max(initial=0.0)]
    hold = float(excess[worst].sum()) >= MOST * float(excess.sum())
    return worst[: len(worst) if hold and len(worst) <= FEW * len(ratios) else 0]


def moments_words(ratios: Array, run: Sequence[str], t: Array, place: Array) -> str:
    """When and where most of the error is, in words; empty where it is spread out.

    Of each window the ratio as for `find_moments`, its drive's name, when it begins in that [s],
    and its place (x, y) [m].
    """
    worst = find_moments(ratios)
    if not len(worst):
        return ""
    excess = np.clip(ratios - 1.0, 0.0, _HUGE)
    share = excess[worst].sum() / excess.sum()
    moments = [f"{run[w]} at {t[w]:.0f} s" for w in worst[:_LISTED]]
    more = ", …" if len(worst) > _LISTED else ""
    middle = place[worst].mean(axis=0)
    at_one = bool((np.linalg.norm(place[worst] - middle, axis=1) < _NEAR).all())
    where = f", near x {middle[0]:.1f} m, y {middle[1]:.1f} m" if at_one else ""
    count = f"{len(worst)} of {len(ratios)} windows"
    return f"{share:.0%} of it is in {count}: {', '.join(moments)}{more}{where}"


def locate(fits: Fits) -> Where:
    """All of it."""
    equation, found = equation_shares(fits), regimes(fits)
    layout, before = fits.predictor.layout, fits.before
    names = [fits.names[run] for run in layout.run]
    moments = moments_words(before.at.ratio, names, layout.t, before.x[:, :2])
    stage = "actuator" if equation[0].name in ("steer", "drive") else "forces"
    sentence = sentence_of(equation, found, moments)
    return Where(stage, equation, channel_shares(fits), stretches(fits), found[:6], sentence)
