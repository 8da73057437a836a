"""Two drives on one axis of time: their curves, the difference, and how far they lie apart."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.sessions.info import Recording
from steerd.daemon.sessions.motion import Array, rms
from steerd.daemon.sessions.plot_data import Curve, make_drawing
from steerd.sysid.report.drawing import INK, LINES, Diagrams
from steerd.sysid.report.report import Section, Table

STEP = 0.01  # of the common axis [s]
REFINED = 0.5
"""Within this of the strongest correlation the best likeness is taken for the shift [s]."""
POINTS_MAX = 1200  # of a drawn curve
LEAST_SHARE = 0.01
"""Least height of a difference's axis to either side, as a share of the first drive's largest."""
_MOTION = ("speed", "steering angle (left +)", "yaw rate")
"""Panels that show when a drive did what; errors are each drive's own."""
_SHOWN = ("lateral error e1", "heading error e2", *_MOTION)


@dataclass(frozen=True, eq=False)
class Pair:
    """A quantity of two drives on one axis of time; NaN where a drive has none of it."""

    title: str
    unit: str
    first: Array  # (n,) values of the first drive; second: of the second
    second: Array

    @property
    def difference(self) -> Array:
        """Second minus first."""
        return self.second - self.first


@dataclass(frozen=True, eq=False)
class Overlay:
    """Two drives over the time that they share."""

    t: Array  # since the first one's start (n,) [s]
    shift: float  # by which the second one comes later [s]
    found: bool  # whether that was found, not given
    pairs: tuple[Pair, ...]  # the quantities that both have


def find_shift(first: Sequence[Array], second: Sequence[Array]) -> float:
    """By how much a second drive must come later to resemble the first [s].

    The strongest cross-correlation of all quantities together finds the place (it favours long
    overlaps, so that of equal laps the nearest is taken); its coefficient over the overlap, which
    favours none, the shift.

    Args:
        first: quantities of the first drive, `STEP` apart, each (n,).
        second: the same quantities of the second, each (m,).
    """
    size = len(first[0]) + len(second[0])
    total, power = np.zeros(size), np.zeros(size)
    for one, other in zip(first, second, strict=True):
        mean, scale = np.nanmean(one), max(float(np.nanstd(one)), 1e-9)
        a, b = (np.nan_to_num((values - mean) / scale) for values in (one, other))
        here, there = (np.isfinite(values).astype(float) for values in (one, other))
        total += _correlate(a, b, size)
        power += np.sqrt(
            np.maximum(_correlate(a**2, there, size) * _correlate(here, b**2, size), 0.0)
        )
    lags = np.fft.fftfreq(size, 1.0 / size)
    near = np.abs(lags - lags[np.argmax(total)]) <= REFINED / STEP
    likeness = np.where(near, total / np.maximum(power, 1e-9), -np.inf)
    return float(lags[np.argmax(likeness)]) * STEP


def _correlate(a: Array, b: Array, size: int) -> Array:
    """Sum of `a[i + lag] b[i]` by lag, negative lags at the end."""
    spectrum = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
    return np.asarray(np.fft.irfft(spectrum, size))


def overlay(first: Recording, second: Recording, shift: float | None = None) -> Overlay:
    """Put two drives on one axis of time, at this shift [s], or at the one that is found.

    Raises:
        SteerdError: they have nothing in common, or no time at that shift.
    """
    panels = [{panel.title: panel for panel in make_drawing(r).panels} for r in (first, second)]
    curves = {
        title: _pick(panels[0][title].curves, panels[1][title].curves)
        for title in _SHOWN
        if all(title in found for found in panels)
    }
    motion = [curves[title] for title in _MOTION if title in curves]
    if not motion:
        what = "the two drives have neither speed nor steering nor yaw rate in common"
        raise SteerdError(what, "name drives that were recorded alike", ExitCode.INVALID)
    lengths = [read.info.duration_s for read in (first, second)]
    at = shift
    if at is None:
        axes = [np.arange(0.0, length + STEP, STEP) for length in lengths]
        sampled = ([_sample(pair[i], axis) for pair in motion] for i, axis in enumerate(axes))
        at = find_shift(*sampled)
    t = np.arange(max(0.0, at), min(lengths[0], lengths[1] + at), STEP)
    if len(t) < 2:
        what = f"shifted by {at:g} s the drives have no time in common"
        hint = f"they last {lengths[0]:.1f} s and {lengths[1]:.1f} s"
        raise SteerdError(what, hint, ExitCode.USAGE)
    pairs = (
        Pair(title, panels[0][title].unit, _sample(one, t), _sample(other, t - at))
        for title, (one, other) in curves.items()
    )
    return Overlay(t, at, shift is None, tuple(pairs))


def _pick(first: Sequence[Curve], second: Sequence[Curve]) -> tuple[Curve, Curve]:
    """The last curve that two panels both have, by name; else the last of each: the estimate."""
    names = {curve.name: curve for curve in second}
    both = [curve for curve in first if curve.name in names]
    return (both[-1], names[both[-1].name]) if both else (first[-1], second[-1])


def _sample(curve: Curve, at: Array) -> Array:
    return np.interp(at, curve.t, curve.value, np.nan, np.nan)


# -- the part of the page --------------------------------------------------------------------------


def make_section(found: Overlay, names: Sequence[str]) -> Section:
    """Table and curves of the two, and of their difference."""
    where = "found by cross-correlation" if found.found else "as given"
    when, common = "later" if found.shift >= 0.0 else "earlier", found.t[-1] - found.t[0]
    heads = ["", f"{names[0]}: RMS", f"{names[1]}: RMS", "difference: mean",
             "difference: RMS", "difference: largest"]  # fmt: skip
    return Section(
        "Over the same time",
        f"{names[1]} is shown {abs(found.shift):.2f} s {when}, {where}; {common:.1f} s are "
        f"common to both. The difference is {names[1]} minus {names[0]}.",
        table=Table(heads, [row for pair in found.pairs for row in _rows(pair)]),
        figures=[
            Diagrams(
                lambda *axes: _plot(axes, found),
                1.8,
                count=2 * len(found.pairs),
                columns=2,
                colours=dict(zip(names, LINES, strict=False)),
            )
        ],
    )


def _rows(pair: Pair) -> Iterator[list[str]]:
    one, other, off = (v[np.isfinite(pair.difference)] for v in (pair.first, pair.second,
                                                                 pair.difference))  # fmt: skip
    if off.size:
        figures = (rms(one), rms(other), float(off.mean()), rms(off), float(np.abs(off).max()))
        yield [f"{pair.title} [{pair.unit}]", *(f"{value:z.3f}" for value in figures)]


def _plot(axes: Sequence[Axes], found: Overlay) -> None:
    """Both curves, then their difference; two diagrams for each quantity."""
    step = max(1, len(found.t) // POINTS_MAX)
    t = found.t[::step]
    for both, off, pair in zip(axes[::2], axes[1::2], found.pairs, strict=True):
        for values, colour in zip((pair.first, pair.second), LINES, strict=False):
            both.plot(t, values[::step], color=colour, lw=1.1)
        off.plot(t, pair.difference[::step], color=INK, lw=0.9)
        both.set(title=f"{pair.title} [{pair.unit}]", xlabel="time [s]")
        off.set(title=f"difference of the {pair.title} [{pair.unit}]", xlabel="time [s]")
        least = LEAST_SHARE * np.nanmax(np.abs(pair.first))
        low, high = off.get_ylim()
        off.set_ylim(min(low, -least), max(high, least))  # what differs by rounding looks so
