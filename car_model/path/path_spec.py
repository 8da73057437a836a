"""Paths by name: `line`, `circle:radius=2`, `figure8:size=5`, `csv:FILE,place=as-is`."""

# Why: docs/decisions/vehicle-model.md#d20

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path as FilePath

import numpy as np
import numpy.typing as npt

from steerd.car_model.path.path import Path
from steerd.car_model.path.path_csv import load_path

STEP = 0.02  # distance that sampled shapes aim at between samples [m]
FIGURE_EIGHT_SWING = 2.404825557695773
"""First zero of the Bessel function J0: the heading swing [rad] that closes a figure eight."""
FIGURE_EIGHT_EXTENT = 5.664286
"""Largest extent of the figure eight over its smallest radius (from its samples; tested)."""
LENGTH_MAX = 1e4  # longest dimension of a shape [m]
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)


def make_line(length: float = 20.0) -> Path:
    """A straight line of `length` [m].

    Raises:
        ValueError: the length is not within (0, LENGTH_MAX].
    """
    _require(0.0 < length <= LENGTH_MAX, f"line: length {length} m; give one like line:length=20")
    count = max(3, round(length / STEP) + 1)
    step = length / (count - 1)
    zero = (0.0,) * count
    return Path("line", step, False, tuple(i * step for i in range(count)), zero, zero, zero)


def make_circle(radius: float = 2.0) -> Path:
    """A circle about (0, radius): counter-clockwise, or clockwise for a negative `radius` [m].

    Raises:
        ValueError: the radius is not between STEP and LENGTH_MAX either way.
    """
    usable = STEP <= abs(radius) <= LENGTH_MAX
    _require(usable, f"circle: radius {radius} m; give one like circle:radius=2")
    length = math.tau * abs(radius)
    count = max(16, round(length / STEP))
    turned = [math.tau * i / count for i in range(count)]
    side = math.copysign(1.0, radius)
    return Path(
        "circle",
        length / count,
        True,
        tuple(abs(radius) * math.sin(a) for a in turned),
        tuple(radius * (1.0 - math.cos(a)) for a in turned),
        tuple(side * a for a in turned),
        (1.0 / radius,) * count,
    )


FIGURE_EIGHT_RADIUS = 1.5
"""Default smallest radius [m]: an F1TENTH car steers 0.26 rad to its worse side, 1.25 m."""


def make_figure_eight(radius: float = FIGURE_EIGHT_RADIUS) -> Path:
    """A figure eight whose curvature is a sine of arc length, at most 1 / `radius` [1/m].

    With k = sin(u) / radius, u = 2 pi s / L, the heading is w (1 - cos u) with w = L / (2 pi
    radius). Once round displaces it by (J0(w), 0) turned by w, so it closes exactly where w is the
    first zero of J0 (the sine-generated curve). It crosses itself at the origin, left lobe first.

    Raises:
        ValueError: the radius is not between STEP and LENGTH_MAX.
    """
    usable = STEP <= radius <= LENGTH_MAX
    _require(usable, f"figure8: radius {radius} m; give one like figure8:radius=1.5")
    length = math.tau * FIGURE_EIGHT_SWING * radius
    count = 4 * max(8, round(length / STEP / 4))
    u = math.tau * np.arange(count) / count
    x, y = _integrate(u, math.tau / count, length / math.tau)
    columns = (x, y, _figure_eight_yaw(u), np.sin(u) / radius)
    return Path("figure8", length / count, True, *(tuple(c.tolist()) for c in columns))


def _figure_eight_yaw(u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return FIGURE_EIGHT_SWING * (1.0 - np.cos(u))


def _integrate(
    u: npt.NDArray[np.float64], width: float, scale: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Positions at the phases `u` by Gauss-Legendre quadrature of the heading between them."""
    yaw = _figure_eight_yaw(u[:-1, None] + 0.5 * width * (1.0 + _GAUSS_NODES))
    weights = 0.5 * width * scale * _GAUSS_WEIGHTS
    start = np.zeros(1)
    return (
        np.concatenate([start, np.cumsum(np.cos(yaw) @ weights)]),
        np.concatenate([start, np.cumsum(np.sin(yaw) @ weights)]),
    )


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


FORMS = (
    "line[:length=20], circle[:radius=2[,dir=cw]], figure8[:radius=1.5 | :size=6], "
    "csv:FILE[,place=start|as-is][,smooth=0.02]"
)
_CSV_OPTION = re.compile(r",(place|smooth)=([^,]*)$")

PathOptions = dict[str, str]


def parse_path(spec: str) -> Path:
    """The path that a text such as `circle:radius=2` names.

    Raises:
        ValueError: says what is wrong and which forms there are.
    """
    kind, _, rest = spec.strip().partition(":")
    if kind == "csv":
        return _csv(rest)
    maker = _SHAPES.get(kind)
    if maker is None:
        raise ValueError(f"no path called {kind!r}; paths are {FORMS}")
    options = dict(_options(spec, rest))
    path = maker(options)
    if options:
        raise ValueError(f"path {spec!r}: {kind} has no option {', '.join(options)}; use {FORMS}")
    return path


def _options(spec: str, text: str) -> Iterator[tuple[str, str]]:
    for item in re.split("[,:]", text) if text else ():
        key, equals, value = item.partition("=")
        if not (key and equals and value):
            raise ValueError(f"path {spec!r}: {item!r} is not name=value; paths are {FORMS}")
        yield key.strip(), value.strip()


def _number(options: PathOptions, key: str, default: float) -> float:
    """Takes an option that is a number out of `options`."""
    text = options.pop(key, None)
    if text is None:
        return default
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{key}={text}: give a number, as {key}={default:g}") from None


def _line(options: PathOptions) -> Path:
    return make_line(_number(options, "length", 20.0))


def _circle(options: PathOptions) -> Path:
    radius = _number(options, "radius", 2.0)
    direction = options.pop("dir", "cw" if radius < 0.0 else "ccw")
    if direction not in ("cw", "ccw"):
        raise ValueError(f"dir={direction}: use dir=ccw (left turn) or dir=cw (right turn)")
    return make_circle(-abs(radius) if direction == "cw" else radius)


def _figure_eight(options: PathOptions) -> Path:
    if "size" in options and "radius" in options:
        raise ValueError("figure8: give its smallest radius or its size, not both")
    if "size" in options:
        return make_figure_eight(_number(options, "size", 5.0) / FIGURE_EIGHT_EXTENT)
    return make_figure_eight(_number(options, "radius", FIGURE_EIGHT_RADIUS))


def _csv(rest: str) -> Path:
    options: PathOptions = {}
    while found := _CSV_OPTION.search(rest):
        options[found[1]] = found[2]
        rest = rest[: found.start()]
    if not rest:
        raise ValueError(f"csv: which file? Paths are {FORMS}")
    smooth = _number(options, "smooth", 0.0)
    try:
        return load_path(FilePath(rest).expanduser(), options.get("place", "start"), smooth)
    except OSError as error:
        raise ValueError(f"path file {rest}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"path file {rest}: not a text of points, one a line") from None


_SHAPES: dict[str, Callable[[PathOptions], Path]] = {
    "line": _line,
    "circle": _circle,
    "figure8": _figure_eight,
}
