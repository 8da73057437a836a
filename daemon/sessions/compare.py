"""Drives side by side as one HTML page: at the same place of their lane, and over the same time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import degrees

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import correlate, correlation_lags

from steerd.car_model.path.path import Path as Lane
from steerd.daemon.common.errors import SteerdError, UsageError
from steerd.daemon.common.screen import clean
from steerd.daemon.sessions.info import Recording
from steerd.daemon.sessions.motion import Track, find_settled, rms
from steerd.daemon.sessions.plot_data import Curve, load_lane, make_drawing
from steerd.sim_gap.lane_comparison import profile
from steerd.steer_bus import topics
from steerd.sysid.data.data_checks import Array
from steerd.sysid.report.drawing import FAINT, INK, LINES, Diagrams
from steerd.sysid.report.page import render_report
from steerd.sysid.report.report import Report, Section, Table

NAME_MAX = 40
POINTS_MAX, _DOTS_MAX = 1200, 400  # of a drawn curve, and of the single samples of every lap


def render_comparison(reads: Sequence[Recording], shift: float | None = None) -> str:
    """The page of several drives: along their lane, and of two also over time.

    The second of two comes later by `shift` [s]; None finds it.

    Raises:
        SteerdError: more or less than two follow no lane, or not the same, or nothing is common.
    """
    names = [clean(read.info.path.name, NAME_MAX) for read in reads]
    two = len(reads) == 2
    over_time = [compare_over_time(overlay(reads[0], reads[1], shift), names)] if two else []
    try:
        drives = [make_lane_session(read) for read in reads]
    except SteerdError as error:  # over time alone
        if not over_time:
            raise
        why = f"Not compared along a lane: {error.what}."
        title, foot = "Two drives, compared", "Written by steerd plot."
        return render_report(Report(title, over_time, foot, subject=", ".join(names), lead=why))
    check_same_lane(drives)
    return render_report(Report(
        title="Drives of one lane, compared",
        subject=", ".join(names),
        about=f"path {clean(drives[0].lane.name, NAME_MAX)}",
        lead="From 3 s after each start.",
        sections=[*compare_on_lane(drives), *over_time],
        foot="Written by steerd plot. Frames are ISO 8855, angles positive to the left.",
    ))  # fmt: skip


# -- along the lane --------------------------------------------------------------------------------

BINS = 400  # places along the lane
_PANELS = (
    ("e1", "lateral error e1 [mm]", 1e3),
    ("e2", "heading error e2 [°]", degrees(1.0)),
    ("speed", "speed [m/s]", 1.0),
    ("steer_ref", "steering command [°], left +", degrees(1.0)),
)
"""Field of the `state` topic, title, scale."""


@dataclass(frozen=True, eq=False)
class LaneSession:
    """One drive on its lane, settled."""

    name: str  # the file's
    lane: Lane  # the path
    track: Track | None  # of the car; None without poses
    place: Array  # along the lane [m], in [0, its length)
    values: dict[str, Array]  # fields of `_PANELS` at these places, SI
    laps: float  # how often the lane's length was driven


def make_lane_session(read: Recording) -> LaneSession:
    """What a drive did along its lane.

    Raises:
        SteerdError: it followed no lane.
    """
    path = read.info.path
    lane, state = load_lane(read.session), read.table(topics.STATE)
    if lane is None or state is None:
        what = f"{path.name} follows no lane that could be compared"
        raise SteerdError(what, "name drives of `steerd run`")
    names = [name for name, _, _ in _PANELS]
    kept = find_settled(state, read.times(state))
    for name in ("path_s", *names):
        kept &= np.isfinite(state[name])
    if kept.sum() < 2:
        what = f"{path.name} keeps its lane for less than the 3 s after which drives are compared"
        raise SteerdError(what, "name a longer drive")
    along = state["path_s"][kept].astype(float)
    return LaneSession(
        clean(path.name, NAME_MAX),
        lane,
        read.track,
        along % lane.length,
        {name: state[name][kept].astype(float) for name in names},
        float(np.abs(np.diff(along)).sum() / lane.length),
    )


def check_same_lane(drives: Sequence[LaneSession]) -> None:
    """Refuse drives of different lanes: a place on one is none on the other.

    Raises:
        SteerdError: two lanes differ in shape or length, or there are too many drives.
    """
    if len(drives) > len(LINES):
        what = f"{len(drives)} drives: {len(LINES)} at most can be distinguished"
        raise UsageError(what, "name fewer")
    first = drives[0]
    for other in drives[1:]:
        one, two = (np.array([drive.lane.x, drive.lane.y]) for drive in (first, other))
        if one.shape != two.shape or not np.allclose(one, two, atol=0.01):
            what = f"{first.name} drives {first.lane.name}, {other.name} {other.lane.name}"
            hint = "compare drives of one --path: places along different lanes do not match"
            raise SteerdError(what, hint)


def compare_on_lane(drives: Sequence[LaneSession]) -> list[Section]:
    """Figures of each, curves over the place along the lane, tracks."""
    names = [drive.name for drive in drives]
    heads = ["", *names, "difference"] if len(drives) == 2 else ["", *names]
    colours = dict(zip(names, LINES, strict=False))

    def plot(*axes: Axes) -> None:
        for axis, (name, title, scale) in zip(axes, _PANELS, strict=True):
            for drive, colour in zip(drives, LINES, strict=False):
                values, step = scale * drive.values[name], max(1, len(drive.place) // _DOTS_MAX)
                dots = drive.place[::step], values[::step]
                axis.plot(*dots, ".", ms=1.0, color=colour, alpha=0.35)
                at = (np.arange(BINS) + 0.5) / BINS * drive.lane.length
                mean = profile(drive.place, drive.lane.length, values, BINS)
                axis.plot(at, mean, color=colour, lw=1.4)
            along = (0.0, drives[0].lane.length)
            axis.set(title=title, xlabel="place along the lane [m]", xlim=along)

    return [
        Section(table=Table(heads, list(_lane_rows(drives)))),
        Section(
            "At the same place along the lane",
            "Dots are single samples of every lap, the line is their mean at that place.",
            figures=[Diagrams(plot, 2.0, count=len(_PANELS), colours=colours)],
        ),
        Section("Tracks", figures=[Diagrams(_plot_tracks, 4.2, (drives,))]),
    ]


def _lane_rows(drives: Sequence[LaneSession]) -> Iterator[list[str]]:
    """Rows of the table: label, a figure a drive, and of two the second's minus the first's."""

    def row(label: str, form: str, figure: Callable[[LaneSession], float]) -> list[str]:
        values = [figure(d) for d in drives]
        off = [f"{values[1] - values[0]:+{form.lstrip('+')}}"] if len(values) == 2 else []
        return [label, *(format(value, form) for value in values), *off]

    yield row("laps", "z.1f", lambda d: d.laps)
    yield row("e1 RMS [mm]", "z.1f", lambda d: 1e3 * rms(d.values["e1"]))
    yield row("e1 mean [mm]", "+z.1f", lambda d: 1e3 * d.values["e1"].mean())
    yield row("e1 largest [mm]", "z.1f", lambda d: 1e3 * np.abs(d.values["e1"]).max())
    yield row("e2 RMS [°]", "z.2f", lambda d: degrees(rms(d.values["e2"])))
    yield row("fastest [m/s]", "z.2f", lambda d: d.values["speed"].max())


def _plot_tracks(axis: Axes, drives: Sequence[LaneSession]) -> None:
    lane = drives[0].lane
    x, y = ([*v, v[0]] if lane.closed else [*v] for v in (lane.x, lane.y))
    axis.plot(x, y, color=FAINT, lw=1.0, ls="--")
    for drive, colour in zip(drives, LINES, strict=False):
        if drive.track is not None:
            step = max(1, len(drive.track.x) // POINTS_MAX)
            axis.plot(drive.track.x[::step], drive.track.y[::step], color=colour, lw=1.1)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x [m]", ylabel="y [m]")


# -- over time -------------------------------------------------------------------------------------

STEP = 0.01  # of the common axis [s]
REFINED = 0.5  # within this of the strongest correlation the best likeness is the shift [s]
LEAST_SHARE = 0.01
"""Least height of a difference's axis to either side, as a share of the first drive's largest."""
_MOTION = ("speed", "steering angle (left +)", "yaw rate")
"""Panels that show when a drive did what; errors are each drive's own."""
_SHOWN = ("lateral error e1", "heading error e2", *_MOTION)


@dataclass(frozen=True, eq=False)
class Overlay:
    """Two drives over the time that they share."""

    t: Array  # since the first one's start (n,) [s]
    shift: float  # by which the second one comes later [s]
    found: bool  # whether that was found, not given
    # Quantities that both have, by title and unit: of the first drive, of the second and the second
    # minus the first (n,); NaN where a drive has none
    pairs: dict[str, tuple[Array, Array, Array]]


def find_shift(first: Sequence[Array], second: Sequence[Array]) -> float:
    """By how much a second drive must come later to resemble the first [s].

    The strongest cross-correlation of all quantities together finds the place (it favours long
    overlaps, so that of equal laps the nearest is taken); its coefficient over the overlap, which
    favours none, the shift. Quantities of the first drive are (n,), of the second (m,), `STEP`
    apart.
    """
    lags = correlation_lags(len(first[0]), len(second[0]))
    total, power = np.zeros(len(lags)), np.zeros(len(lags))
    for one, other in zip(first, second, strict=True):
        mean, scale = np.nanmean(one), max(float(np.nanstd(one)), 1e-9)
        a, b = (np.nan_to_num((values - mean) / scale) for values in (one, other))
        here, there = (np.isfinite(values).astype(float) for values in (one, other))
        total += correlate(a, b, method="fft")
        both = correlate(a**2, there, method="fft") * correlate(here, b**2, method="fft")
        power += np.sqrt(np.maximum(both, 0.0))
    near = np.abs(lags - lags[np.argmax(total)]) <= REFINED / STEP
    likeness = np.where(near, total / np.maximum(power, 1e-9), -np.inf)
    return float(lags[np.argmax(likeness)]) * STEP


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
        raise SteerdError(what, "name drives that were recorded alike")
    lengths = [read.info.duration_s for read in (first, second)]
    at = shift
    if at is None:
        axes = [np.arange(0.0, length + STEP, STEP) for length in lengths]
        sampled = ([_sample(pair[i], axis) for pair in motion] for i, axis in enumerate(axes))
        at = find_shift(*sampled)
    t = np.arange(max(0.0, at), min(lengths[0], lengths[1] + at), STEP)
    if len(t) < 2:
        what = f"shifted by {at:g} s the drives have no time in common"
        raise UsageError(what, f"they last {lengths[0]:.1f} s and {lengths[1]:.1f} s")
    pairs = {}
    for title, curve in curves.items():
        one, other = _sample(curve[0], t), _sample(curve[1], t - at)
        pairs[f"{title} [{panels[0][title].unit}]"] = one, other, other - one
    return Overlay(t, at, shift is None, pairs)


def _pick(first: Sequence[Curve], second: Sequence[Curve]) -> tuple[Curve, Curve]:
    """The last curve that two panels both have, by name; else the last of each: the estimate."""
    names = {curve.name: curve for curve in second}
    both = [curve for curve in first if curve.name in names]
    return (both[-1], names[both[-1].name]) if both else (first[-1], second[-1])


def _sample(curve: Curve, at: Array) -> Array:
    return np.interp(at, curve.t, curve.value, np.nan, np.nan)


def compare_over_time(found: Overlay, names: Sequence[str]) -> Section:
    """Table and curves of the two, and of their difference."""
    where = "found by cross-correlation" if found.found else "as given"
    when, common = "later" if found.shift >= 0.0 else "earlier", found.t[-1] - found.t[0]
    heads = ["", f"{names[0]}: RMS", f"{names[1]}: RMS", "difference: mean",
             "difference: RMS", "difference: largest"]  # fmt: skip
    rows = []
    for title, values in found.pairs.items():
        one, other, off = (each[np.isfinite(values[2])] for each in values)
        if off.size:
            figures = (rms(one), rms(other), float(off.mean()), rms(off), float(np.abs(off).max()))
            rows.append([title, *(f"{value:z.3f}" for value in figures)])
    colours, step = dict(zip(names, LINES, strict=False)), max(1, len(found.t) // POINTS_MAX)

    def plot(*axes: Axes) -> None:
        for both, off, title in zip(axes[::2], axes[1::2], found.pairs, strict=True):
            t, (*drives, difference) = found.t[::step], found.pairs[title]
            for values, colour in zip(drives, LINES, strict=False):
                both.plot(t, values[::step], color=colour, lw=1.1)
            off.plot(t, difference[::step], color=INK, lw=0.9)
            both.set(title=title, xlabel="time [s]")
            off.set(title=f"difference of the {title}", xlabel="time [s]")
            least = LEAST_SHARE * np.nanmax(np.abs(drives[0]))
            low, high = off.get_ylim()
            off.set_ylim(min(low, -least), max(high, least))  # what differs by rounding looks so

    return Section(
        "Over the same time",
        f"{names[1]} is shown {abs(found.shift):.2f} s {when}, {where}; {common:.1f} s are "
        f"common to both. The difference is {names[1]} minus {names[0]}.",
        table=Table(heads, rows),
        figures=[Diagrams(plot, 1.8, count=2 * len(found.pairs), colours=colours)],
    )
