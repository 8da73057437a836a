"""What a car sends while it drives, kept for as long as a window needs it."""

from dataclasses import dataclass, replace
from itertools import dropwhile
from math import hypot, isfinite
from typing import NamedTuple, TypeVar

import numpy as np

from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import HISTORY, Run, Signal, make_run
from steerd.sysid.data.segments import SPEED_MIN

WINDOW = 0.5  # length of a window [s]: ten of the car's time constants, and a change shows soon
LEAD = HISTORY + 0.1  # commands known before a window [s]; on the grid some of it is lost
PAST = 2.0  # commands before a window that are kept, for what a linkage with play remembers [s]
LATE = 0.06  # a window is closed when a pose this much younger has come: telemetry may lag [s]
KEPT = PAST + WINDOW + 1.0  # how long samples are kept [s]


class PoseSeen(NamedTuple):
    """A pose that the mocap checks let pass: time of validity [s], place [m], yaw [rad]."""

    t: float
    x: float
    y: float
    yaw: float


class Ordered(NamedTuple):
    """A command as sent: time [s], wheel angle [rad], speed [m/s]."""

    t: float
    steer: float
    speed: float


class Rolled(NamedTuple):
    """A wheel speed: time [s], speed under the nominal gain [m/s]."""

    t: float
    speed: float


class Paused(NamedTuple):
    """The car is not driven at this time [s]: no window reaches across it."""

    t: float


Sample = PoseSeen | Ordered | Rolled | Paused
S = TypeVar("S", PoseSeen, Ordered, Rolled)


@dataclass(frozen=True)
class Recent:
    """Samples of the last seconds, each kind in the order of time."""

    poses: tuple[PoseSeen, ...] = ()
    orders: tuple[Ordered, ...] = ()
    wheel: tuple[Rolled, ...] = ()

    @property
    def newest(self) -> float:
        """Time of the last pose [s]."""
        return self.poses[-1].t if self.poses else -np.inf


def _added(kept: tuple[S, ...], sample: S) -> tuple[S, ...]:
    """With one more; a sample that is no number or not newer than the last is left out."""
    if not all(map(isfinite, sample)) or (kept and sample.t <= kept[-1].t):
        return kept
    newest: tuple[S] = (sample,)
    return tuple(dropwhile(lambda each: each.t < sample.t - KEPT, kept)) + newest


def take(recent: Recent, sample: Sample) -> Recent:
    """The samples with one more."""
    match sample:
        case PoseSeen():
            return replace(recent, poses=_added(recent.poses, sample))
        case Ordered():
            return replace(recent, orders=_added(recent.orders, sample))
        case Rolled():
            return replace(recent, wheel=_added(recent.wheel, sample))
        case Paused():
            return Recent()


def first_start(recent: Recent) -> float:
    """Earliest time at which a window may begin [s]; infinite without poses or commands."""
    if not recent.poses or not recent.orders:
        return np.inf
    return max(recent.poses[0].t, recent.orders[0].t + LEAD)


def make_window(recent: Recent, start: float) -> Run | None:
    """The window that begins at `start` [s], None where the car did not drive through it."""
    end = start + WINDOW
    poses = [p for p in recent.poses if start <= p.t < end]
    orders = [o for o in recent.orders if start - PAST <= o.t < end + LATE]
    wheel = [w for w in recent.wheel if start <= w.t < end]
    lately = [abs(o.speed) for o in orders if o.t >= start - LEAD]
    if len(poses) < 2 or min(lately, default=0.0) < SPEED_MIN:
        return None
    first, last, span = poses[0], poses[-1], poses[-1].t - poses[0].t
    if span < 0.8 * WINDOW or hypot(last.x - first.x, last.y - first.y) <= SPEED_MIN * span:
        return None
    seen, rolled = np.array(poses), np.array(wheel).reshape(-1, 2)
    t, steer, speed = np.array(orders).T
    pose, speeds = Signal(seen[:, 0], seen[:, 1:]), Signal(rolled[:, 0], rolled[:, 1])
    try:
        run = make_run(f"{start:.2f} s", Signal(t, steer), Signal(t, speed), pose, wheel=speeds)
        return replace(run, history=PAST)
    except DataError:
        return None
