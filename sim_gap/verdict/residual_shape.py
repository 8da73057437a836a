"""What is left: its spectrum, what it goes with, whether it is like noise; window by window."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from steerd.sim_gap.verdict.where import conditions
from steerd.sysid.data.data_checks import Array
from steerd.sysid.inference.likelihood import Likelihood
from steerd.sysid.inference.predictor import Predictor
from steerd.sysid.inference.search import Point

_CORRELATED = 0.3
_WHITE = 2.0


@dataclass(frozen=True)
class Shape:
    """The remaining error."""

    peak_hz: float  # where the spectrum of the yaw error is largest; `prominence` per its mean
    prominence: float
    dependence: dict[str, float]  # rank correlations of windows' errors with what the car was doing
    noise_like: bool  # white in time, and growing with speed: jitter of stamps or lost frames


def shape_of(likelihood: Likelihood, fitted: Point) -> Shape:
    """Describe the error that a fit leaves."""
    peak, prominence = _spectrum(likelihood, fitted)
    each = fitted.at.ratio
    found = {
        name: _rank_correlation(values, each)
        for name, values in conditions(likelihood.predictor, fitted).items()
    }
    strong = {k: v for k, v in sorted(found.items(), key=lambda i: -abs(i[1])) if abs(v) > 0.15}
    grows = found.get("speed", 0.0) > _CORRELATED
    return Shape(peak, prominence, strong, grows and prominence < _WHITE)


def _spectrum(likelihood: Likelihood, fitted: Point) -> tuple[float, float]:
    """Peak of the mean spectrum of whitened yaw errors [Hz], and its height over the mean."""
    predictor = likelihood.predictor
    white = fitted.linear.error * np.sqrt(likelihood.precision)
    channel = predictor.channel
    rows = [w[(c == 2) & (t > 0)] for w, c, t in zip(
        white, channel, predictor.padded.there, strict=True
    )]  # fmt: skip
    length = int(np.median([len(r) for r in rows]))
    even = np.array([r[:length] for r in rows if len(r) >= length])
    if length < 8 or not len(even):
        return float("nan"), 1.0
    power = (np.abs(np.fft.rfft(even - even.mean(axis=1, keepdims=True), axis=1)) ** 2).mean(axis=0)
    step = float(np.median(np.diff(predictor.layout.row_t[predictor.layout.channel == 2][:length])))
    at = int(np.argmax(power[1:])) + 1
    return float(at / (length * step)), float(power[at] / max(power[1:].mean(), 1e-12))


def _rank_correlation(a: Array, b: Array) -> float:
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    first, second = (np.argsort(np.argsort(v)).astype(float) for v in (a, b))
    return float(np.corrcoef(first, second)[0, 1])


@dataclass(frozen=True, eq=False)
class Timeline:
    """Whitened squared error per degree of freedom of each window; 1 is noise alone."""

    run: tuple[str, ...]  # (W,) name of the drive
    t0: Array  # (W,) where the window begins in its drive [s]; t1: where it ends
    t1: Array
    before: Array  # (W,) under the base
    after: Array  # (W,) under the explanation


def timeline_of(
    predictor: Predictor, before: Point, after: Point, names: Sequence[str]
) -> Timeline:
    """The time line of two fits; `names` are those of the runs."""
    layout = predictor.layout
    return Timeline(
        tuple(names[r] for r in layout.run),
        layout.t.copy(),
        layout.t + layout.spans[:, 3] * layout.h,
        before.at.ratio,
        after.at.ratio,
    )
