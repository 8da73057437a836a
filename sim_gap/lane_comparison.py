"""Lane keeping compared: does a simulated loop resemble the recorded one, and which of two more?

A profile is what a lane keeper leaves: lateral offset e1 and heading error e2 over the way along
the lane. Laps are averaged, so noise falls out and what the car's dynamics make of each bend stays.
The spectrum of the steering command shows what the loop does in time.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from steerd.sysid.data.data_checks import Array

BINS = 100  # places along the lane at which profiles are compared
SEGMENT = 10.0  # length of the spectra's segments [s]
BAND = (0.2, 8.0)  # where spectra are compared [Hz]: bends and the loop's own modes; above is noise
FLOOR = 1e-3  # amplitude density below which steering is noise [rad/sqrt(Hz)]
SHORTEST = 6.0  # a shorter drive has no profile [s]


@dataclass(frozen=True, eq=False)
class LaneDrive:
    """One drive in the lane, the way into it left out; all arrays (N,), evenly in time."""

    t: Array  # [s]
    s: Array  # way along the lane [m]
    e1: Array  # lateral offset [m]; e2: heading error [rad]
    e2: Array
    steer: Array  # commanded angle [rad]
    length: float  # of the lane [m]


class Likeness(NamedTuple):
    """How far a simulated drive is from the recorded one."""

    e1: float  # RMS difference of the profiles [m]; e2: [rad]
    e2: float
    steer_db: float  # RMS difference of the steering's spectra [dB]


@dataclass(frozen=True, eq=False)
class LaneComparison:
    """The recorded drive and its simulations."""

    recorded: LaneDrive  # as driven
    without: LaneDrive | None  # simulated with the base car; a stopped simulation is None
    with_effect: LaneDrive | None  # simulated with the found effect; None without, or stopped
    session: str  # which drive
    again: str = ""  # options of `steerd run` that drive this lane
    remarks: tuple[str, ...] = ()  # what a reader should know, in words

    @property
    def drives(self) -> dict[str, LaneDrive | None]:
        """All three; of the recorded one as much as was simulated, so that bends are the same."""
        cut = self.recorded if self.without is None else as_long(self.recorded, self.without)
        return {"recorded": cut, "without": self.without, "with_effect": self.with_effect}

    @property
    def distances(self) -> tuple[Likeness | None, Likeness | None]:
        """From the recorded drive: without and with the effect."""
        pair = (self.without, self.with_effect)
        first, second = (None if d is None else likeness(self.recorded, d) for d in pair)
        return first, second

    @property
    def votes(self) -> tuple[bool, ...]:
        """Whether each of three measures is closer with the effect; empty without a comparison."""
        before, after = self.distances
        if before is None or after is None:
            return ()
        return after.e1 < before.e1, after.e2 < before.e2, after.steer_db < before.steer_db


def steering_spectrum(drive: LaneDrive) -> tuple[Array, Array]:
    """Frequencies [Hz] and amplitude density [rad/sqrt(Hz)] of the steering, within the band."""
    from scipy.signal import welch  # a second that a diagnosis without a lane need not wait

    rate = 1.0 / float(np.median(np.diff(drive.t)))
    length = min(len(drive.steer), round(SEGMENT * rate))
    f, power = welch(drive.steer, rate, nperseg=length, detrend="constant")
    kept = (f >= BAND[0] - 1e-9) & (f <= BAND[1])
    return f[kept], np.sqrt(power[kept])


def _peak(t: Array, values: Array) -> float:
    """Frequency at which a signal is strongest, its mean left out [Hz]."""
    from scipy.signal import periodogram

    f, power = periodogram(values, 1.0 / float(np.median(np.diff(t))), detrend="constant")
    return float(f[1:][np.argmax(power[1:])])


def figures_of(drive: LaneDrive) -> dict[str, float]:
    """RMS, mean and spectral peak [Hz] of e1 [m] and e2 [rad]; of the steering [rad] no mean."""
    found = {}
    for name in ("e1", "e2", "steer"):
        values = getattr(drive, name)
        found[f"{name}_rms"] = float(np.sqrt(np.mean(values**2)))
        if name != "steer":
            found[f"{name}_mean"] = float(values.mean())
        found[f"{name}_peak_hz"] = _peak(drive.t, values)
    return found


def profile(along: Array, length: float, values: Array, bins: int = BINS) -> Array:
    """(bins,) mean of values at places along a lane [m]; NaN where the drive never was."""
    place = np.floor((along / length % 1.0) * bins).astype(int).clip(0, bins - 1)
    count = np.bincount(place, minlength=bins)
    total = np.bincount(place, weights=values, minlength=bins)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _profile_distance(a: LaneDrive, b: LaneDrive, field: str) -> float:
    first, second = (profile(d.s, d.length, getattr(d, field)) for d in (a, b))
    both = np.isfinite(first) & np.isfinite(second)
    if not both.any():
        return float("inf")
    return float(np.sqrt(np.mean((first[both] - second[both]) ** 2)))


def as_long(drive: LaneDrive, other: LaneDrive) -> LaneDrive:
    """The beginning of a drive, as long as another: figures of both then see the same bends."""
    kept = drive.t - drive.t[0] <= np.ptp(other.t) + 1e-6
    t, s, e1, e2, steer = (a[kept] for a in (drive.t, drive.s, drive.e1, drive.e2, drive.steer))
    return LaneDrive(t, s, e1, e2, steer, drive.length)


def likeness(recorded: LaneDrive, other: LaneDrive) -> Likeness:
    """How far another drive on the same lane is from the recorded one."""
    f, first = steering_spectrum(as_long(recorded, other))
    g, second = steering_spectrum(other)
    a, b = (20.0 * np.log10(np.maximum(v, FLOOR)) for v in (first, np.interp(f, g, second)))
    e1, e2 = (_profile_distance(recorded, other, field) for field in ("e1", "e2"))
    return Likeness(e1, e2, float(np.sqrt(np.mean((a - b) ** 2))))


def encode_lane(lane: LaneComparison) -> dict[str, Any]:
    """The comparison as JSON values."""
    named = zip(("without", "with_effect"), lane.distances, strict=True)
    return {
        "session": lane.session,
        "drives": {n: None if d is None else figures_of(d) for n, d in lane.drives.items()},
        "distance": {name: None if each is None else each._asdict() for name, each in named},
        "nearer": sum(lane.votes) >= 2 if lane.votes else None,  # in most measures
        "remarks": list(lane.remarks),
    }
