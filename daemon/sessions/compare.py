"""Drives of one lane side by side: what each did at the same place, as one HTML page."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import degrees

import numpy as np
from matplotlib.axes import Axes

from steerd.car_model.path.path import Path as Lane
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.screen import clean
from steerd.daemon.sessions import compare_time
from steerd.daemon.sessions.info import Recording
from steerd.daemon.sessions.motion import Array, Track, find_settled, rms
from steerd.daemon.sessions.plot_data import load_lane
from steerd.sim_gap.lane_comparison import profile
from steerd.steer_bus import topics
from steerd.sysid.report.drawing import FAINT, LINES, Diagrams
from steerd.sysid.report.page import render_report
from steerd.sysid.report.report import Report, Section, Table

BINS = 400  # places along the lane
NAME_MAX = 40
_POINTS_MAX, _DOTS_MAX = 1200, 400
_PANELS = (
    ("e1", "lateral error e1 [mm]", 1e3),
    ("e2", "heading error e2 [°]", degrees(1.0)),
    ("speed", "speed [m/s]", 1.0),
    ("steer_ref", "steering command [°], left +", degrees(1.0)),
)
"""Field of the `state` topic, title, scale."""


@dataclass(frozen=True, eq=False)
class LaneSession:
    """One drive on its lane, settled.

    Attributes:
        name: the file's.
        spec: the path, as `--path` took it.
        lane: the path.
        track: of the car; None without poses.
        place: along the lane [m], in [0, its length).
        values: fields of `_PANELS` at these places, SI.
        laps: how often the lane's length was driven.
    """

    name: str
    spec: str
    lane: Lane
    track: Track | None
    place: Array
    values: dict[str, Array]
    laps: float


def make_lane_session(read: Recording) -> LaneSession:
    """What a drive did along its lane.

    Raises:
        SteerdError: it followed no lane.
    """
    path = read.info.path
    lane, state = load_lane(read.session), read.table(topics.STATE)
    if lane is None or state is None:
        what = f"{path.name} follows no lane that could be compared"
        raise SteerdError(what, "name drives of `steerd run`", ExitCode.INVALID)
    names = [name for name, _, _ in _PANELS]
    kept = find_settled(state, read.times(state))
    for name in ("path_s", *names):
        kept &= np.isfinite(state[name])
    if kept.sum() < 2:
        what = f"{path.name} keeps its lane for less than the 3 s after which drives are compared"
        raise SteerdError(what, "name a longer drive", ExitCode.INVALID)
    along = state["path_s"][kept].astype(float)
    return LaneSession(
        clean(path.name, NAME_MAX),
        lane.name,
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
        raise SteerdError(what, "name fewer", ExitCode.USAGE)
    first = drives[0]
    for other in drives[1:]:
        same = len(first.lane.x) == len(other.lane.x)
        same = same and np.allclose(first.lane.x, other.lane.x, atol=0.01)
        if not (same and np.allclose(first.lane.y, other.lane.y, atol=0.01)):
            what = f"{first.name} drives {first.spec}, {other.name} {other.spec}"
            hint = "compare drives of one --path: places along different lanes do not match"
            raise SteerdError(what, hint, ExitCode.INVALID)


def render_recordings(reads: Sequence[Recording], shift: float | None = None) -> str:
    """The page of several drives: along their lane, and of two also over time.

    Args:
        reads: the drives.
        shift: by which the second of two comes later [s]; None finds it.

    Raises:
        SteerdError: more or less than two follow no lane, or not the same, or nothing is common.
    """
    if len(reads) != 2:
        drives = [make_lane_session(read) for read in reads]
        check_same_lane(drives)
        return render_comparison(drives)
    names = [clean(read.info.path.name, NAME_MAX) for read in reads]
    both = compare_time.make_section(compare_time.overlay(reads[0], reads[1], shift), names)
    try:
        drives = [make_lane_session(read) for read in reads]
    except SteerdError as error:  # over time alone
        why = f"Not compared along a lane: {error.what}."
        title, foot = "Two drives, compared", "Written by steerd plot."
        return render_report(Report(title, ", ".join(names), "", why, [both], foot))
    check_same_lane(drives)
    return render_comparison(drives, both)


def render_comparison(drives: Sequence[LaneSession], over_time: Section | None = None) -> str:
    """The page of several drives of one lane, with what is known of two of them over time."""
    names = [drive.name for drive in drives]
    heads = ["", *names, "difference"] if len(drives) == 2 else ["", *names]
    report = Report(
        title="Drives of one lane, compared",
        subject=", ".join(names),
        about=f"path {clean(drives[0].spec, NAME_MAX)}",
        lead="From 3 s after each start.",
        sections=[
            Section(table=Table(heads, list(_rows(drives)))),
            Section(
                "At the same place along the lane",
                "Dots are single samples of every lap, the line is their mean at that place.",
                figures=[
                    Diagrams(
                        lambda *axes: _plot_curves(axes, drives),
                        2.0,
                        count=len(_PANELS),
                        columns=2,
                        colours=dict(zip(names, LINES, strict=False)),
                    )
                ],
            ),
            Section("Tracks", figures=[Diagrams(_plot_tracks, 4.2, (drives,))]),
            *([over_time] if over_time else []),
        ],
        foot="Written by steerd plot. Frames are ISO 8855, angles positive to the left.",
    )
    return render_report(report)


def _rows(drives: Sequence[LaneSession]) -> Iterator[list[str]]:
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
    """Tracks over the lane."""
    lane = drives[0].lane
    x, y = ([*v, v[0]] if lane.closed else [*v] for v in (lane.x, lane.y))
    axis.plot(x, y, color=FAINT, lw=1.0, ls="--")
    for drive, colour in zip(drives, LINES, strict=False):
        if drive.track is not None:
            step = max(1, len(drive.track.x) // _POINTS_MAX)
            axis.plot(drive.track.x[::step], drive.track.y[::step], color=colour, lw=1.1)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x [m]", ylabel="y [m]")


def _plot_curves(axes: Sequence[Axes], drives: Sequence[LaneSession]) -> None:
    """Errors, speed and steering over the place along the lane."""
    for axis, (name, title, scale) in zip(axes, _PANELS, strict=True):
        for drive, colour in zip(drives, LINES, strict=False):
            _draw_drive(axis, drive, scale * drive.values[name], colour)
        axis.set(title=title, xlabel="place along the lane [m]", xlim=(0.0, drives[0].lane.length))


def _draw_drive(axis: Axes, drive: LaneSession, values: Array, colour: str) -> None:
    """Every lap, faint, and the mean of them."""
    step = max(1, len(values) // _DOTS_MAX)
    axis.plot(drive.place[::step], values[::step], ".", ms=1.0, color=colour, alpha=0.35)
    at = (np.arange(BINS) + 0.5) / BINS * drive.lane.length
    axis.plot(at, profile(drive.place, drive.lane.length, values, BINS), color=colour, lw=1.4)
