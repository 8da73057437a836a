"""A path on the ground: samples at equal arc-length steps, and where a point lies against it.

The nearest point is sought from the last one, along the path: a tick costs the same however long
the path is, and the crossing of a figure eight cannot pull the search onto the other branch. Per
tick everything is plain floats. See `docs/reference/paths.md`.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

SEARCH_REACH = 1.0
"""How far along the path a local search may move from its hint [m]: 5 m/s for 0.2 s."""
SEARCH_ROUNDS = 6
"""Newton rounds of the local search; two are usual, and the last needs no further accuracy."""
HEADING_WEIGHT = 1.0
"""What a radian of heading error counts in metres when a branch is chosen [m/rad]."""
SAMPLES_MIN = 3  # fewest samples that make a path


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """Samples of a curve at `step` metres of arc length; sample `i` lies at `s = i * step`.

    A closed path has `length / step` samples (the first is not repeated), an open one has one more.
    Outside its ends an open path goes on straight. Speeds and widths are those of a raceline or
    track file, where it gave any.
    """

    name: str
    step: float  # arc length between samples [m]
    closed: bool
    x: tuple[float, ...]
    y: tuple[float, ...]
    yaw: tuple[float, ...]
    """Direction of travel [rad], from the world's x axis, positive to the left, continuous."""
    curvature: tuple[float, ...]  # [1/m], positive in a left turn
    speed: tuple[float, ...] | None = None  # speed of the file [m/s]
    width_left: tuple[float, ...] | None = None  # free width to the left [m]
    width_right: tuple[float, ...] | None = None  # free width to the right [m]

    def __post_init__(self) -> None:
        count = len(self.x)
        columns = (self.y, self.yaw, self.curvature, self.speed, self.width_left, self.width_right)
        if count < SAMPLES_MIN or self.step <= 0.0:
            raise ValueError(
                f"path {self.name!r}: {count} samples {self.step} m apart; it needs at least "
                f"{SAMPLES_MIN} at a positive step"
            )
        if any(column is not None and len(column) != count for column in columns):
            raise ValueError(f"path {self.name!r}: columns differ in length")
        known = (self.x, *(column for column in columns if column is not None))
        if not all(math.isfinite(value) for column in known for value in column):
            raise ValueError(f"path {self.name!r}: a value is not finite; check its source")

    def __repr__(self) -> str:
        form = "closed" if self.closed else "open"
        return f"<{form} path {self.name!r}: {len(self.x)} samples, {self.length:.2f} m>"

    @property
    def length(self) -> float:
        """Arc length [m], once round for a closed path."""
        return self.step * (len(self.x) if self.closed else len(self.x) - 1)

    @property
    def s(self) -> tuple[float, ...]:
        """Arc length of each sample [m]."""
        return tuple(i * self.step for i in range(len(self.x)))


class Projection(NamedTuple):
    """A point's place against a path."""

    s: float  # arc length of the nearest point [m], in [0, length)
    hint: int  # the sample next to it: where the next projection starts
    e1: float  # lateral offset of the point [m], positive to the left of the path
    yaw_path: float  # direction of the path there [rad]
    curvature: float  # [1/m]
    distance: float
    """Distance to the path [m]; exceeds `|e1|` only outside the ends of an open path."""


def wrap_angle(angle: float) -> float:
    """`angle` [rad] plus whole turns, in (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def interpolate(path: Path, column: tuple[float, ...], s: float) -> float:
    """`column` at arc length `s` [m], linear between samples; ends hold, closed paths go round."""
    place = s / path.step
    low = math.floor(place)
    share = place - low
    count = len(column)
    if path.closed:
        low %= count
        high = low + 1 if low + 1 < count else 0
    elif low < 0:
        return column[0]
    elif low >= count - 1:
        return column[-1]
    else:
        high = low + 1
    value = column[low]
    return value + share * (column[high] - value)


def _touch(path: Path, index: int, x: float, y: float, curvature: float) -> tuple[float, float]:
    """Arc length from sample `index` to the foot on its circle, and the offset from it.

    Exact for an arc of constant curvature. With t, n the point in the sample's frame the circle's
    centre is at (0, 1/k); the forms used stay finite as k goes to 0.
    """
    dx, dy = x - path.x[index], y - path.y[index]
    sin, cos = math.sin(path.yaw[index]), math.cos(path.yaw[index])
    t, n = cos * dx + sin * dy, cos * dy - sin * dx
    if curvature == 0.0:
        return t, n
    kt, kn = curvature * t, 1.0 - curvature * n
    left = (2.0 * n - curvature * (t * t + n * n)) / (1.0 + math.hypot(kt, kn))
    return math.atan2(kt, kn) / curvature, left


def project(path: Path, x: float, y: float, hint: int) -> Projection:
    """Where the point (x, y) [m] lies, searched along the path from sample `hint`.

    The foot is exact on lines and arcs; on a path of varying curvature the offset errs by about
    `k' step^3 / 48` (below 1e-6 m for the built-in shapes).

    Raises:
        IndexError: `hint` is not a sample of the path.
    """
    count = len(path.x)
    remaining = SEARCH_REACH
    index = hint
    along, left = _touch(path, index, x, y, path.curvature[index])
    for _ in range(SEARCH_ROUNDS):
        move = round(max(-remaining, min(remaining, along)) / path.step)
        after = (index + move) % count if path.closed else max(0, min(count - 1, index + move))
        if after == index:
            break
        index = after
        remaining = max(remaining - abs(move) * path.step, path.step)
        along, left = _touch(path, index, x, y, path.curvature[index])
    return _place(path, index, along, left, x, y)


def _place(path: Path, index: int, along: float, left: float, x: float, y: float) -> Projection:
    """The projection with its foot `along` from sample `index`, and the point `left` of it."""
    s = index * path.step + along
    if path.closed:
        s %= path.length
    elif s < 0.0 or s > path.length:
        along, left = _touch(path, index, x, y, 0.0)
        distance = math.hypot(along, left)
        end = 0.0 if s < 0.0 else path.length
        return Projection(end, index, left, path.yaw[index], 0.0, distance)
    at_sample = path.curvature[index]
    curvature = interpolate(path, path.curvature, s)
    yaw_path = path.yaw[index] + 0.5 * (at_sample + curvature) * along
    return Projection(s, index, left, yaw_path, curvature, abs(left))


def locate(path: Path, x: float, y: float, yaw: float | None = None) -> Projection:
    """The nearest place of the whole path: for the start, and after the pose was lost.

    With a heading `yaw` [rad] the branch that runs the car's way wins where branches cross.
    """

    def cost(distance: float, direction: float) -> float:
        turn = 0.0 if yaw is None else HEADING_WEIGHT * wrap_angle(yaw - direction)
        return math.hypot(distance, turn)

    costs = [
        cost(math.hypot(x - px, y - py), direction)
        for px, py, direction in zip(path.x, path.y, path.yaw, strict=True)
    ]
    enough = min(costs) + path.step
    near = (project(path, x, y, i) for i, value in enumerate(costs) if value <= enough)
    return min(near, key=lambda seen: cost(seen.distance, seen.yaw_path))


def place_at_origin(path: Path) -> Path:
    """The path moved and turned as a whole so that it starts at the origin along +x."""
    x0, y0, yaw0 = path.x[0], path.y[0], path.yaw[0]
    sin, cos = math.sin(yaw0), math.cos(yaw0)
    shifted = [(x - x0, y - y0) for x, y in zip(path.x, path.y, strict=True)]
    return replace(
        path,
        x=tuple(cos * dx + sin * dy for dx, dy in shifted),
        y=tuple(cos * dy - sin * dx for dx, dy in shifted),
        yaw=tuple(yaw - yaw0 for yaw in path.yaw),
    )
