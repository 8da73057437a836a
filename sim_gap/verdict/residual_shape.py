"""What is left: its spectrum, what it goes with, whether it is like noise; window by window."""

from dataclasses import dataclass

import numpy as np

from steerd.sim_gap.verdict.where import Fits, conditions
from steerd.sysid.data.data_checks import Array

_CORRELATED = 0.3
_WHITE = 2.0


@dataclass(frozen=True)
class Shape:
    """The remaining error."""

    peak_hz: float  # where the spectrum of the yaw error is largest; `prominence` per its mean
    prominence: float
    dependence: dict[str, float]  # rank correlations of windows' errors with what the car was doing
    noise_like: bool  # white in time, and growing with speed: jitter of stamps or lost frames


def shape_of(fits: Fits) -> Shape:
    """Describe the error that the explanation leaves."""
    peak, prominence = _spectrum(fits)
    each, driven = fits.after.at.ratio, conditions(fits.predictor, fits.after)
    found = {name: _rank_correlation(values, each) for name, values in driven.items()}
    strong = {k: v for k, v in sorted(found.items(), key=lambda i: -abs(i[1])) if abs(v) > 0.15}
    grows = found.get("speed", 0.0) > _CORRELATED
    return Shape(peak, prominence, strong, grows and prominence < _WHITE)


def _spectrum(fits: Fits) -> tuple[float, float]:
    """Peak of the mean spectrum of whitened yaw errors [Hz], and its height over the mean."""
    predictor, layout = fits.predictor, fits.predictor.layout
    white = fits.after.linear.error * np.sqrt(fits.likelihood.precision)
    turn = (predictor.channel == 2) & (predictor.padded.there > 0)
    rows = [window[mine] for window, mine in zip(white, turn, strict=True)]
    length = int(np.median([len(r) for r in rows]))
    even = np.array([r[:length] for r in rows if len(r) >= length])
    if length < 8 or not len(even):
        return float("nan"), 1.0
    power = (np.abs(np.fft.rfft(even - even.mean(axis=1, keepdims=True), axis=1)) ** 2).mean(axis=0)
    step = float(np.median(np.diff(layout.row_t[layout.channel == 2][:length])))
    at = int(np.argmax(power[1:])) + 1
    return float(at / (length * step)), float(power[at] / max(power[1:].mean(), 1e-12))


def _rank_correlation(*both: Array) -> float:
    """Values that are the same but for rounding share their rank (SciPy: 0.4 s of import)."""
    ranks = []
    for values in both:
        _, place, count = np.unique(values.round(9), return_inverse=True, return_counts=True)
        ranks.append((np.cumsum(count) - 0.5 * count)[place])
    varied = min(map(np.ptp, ranks)) > 0.0
    return float(np.corrcoef(ranks)[0, 1]) if varied else 0.0


@dataclass(frozen=True, eq=False)
class Timeline:
    """Whitened squared error per degree of freedom of each window; 1 is noise alone."""

    run: tuple[str, ...]  # (W,) name of the drive
    t0: Array  # (W,) where the window begins in its drive [s]; t1: where it ends
    t1: Array
    before: Array  # (W,) under the base
    after: Array  # (W,) under the explanation


def timeline_of(fits: Fits) -> Timeline:
    """The time line of both fits."""
    layout = fits.predictor.layout
    run, end = tuple(fits.names[r] for r in layout.run), layout.t + layout.spans[:, 3] * layout.h
    return Timeline(run, layout.t.copy(), end, fits.before.at.ratio, fits.after.at.ratio)
