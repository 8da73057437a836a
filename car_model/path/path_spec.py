"""Paths by name: `line`, `circle:radius=2`, `figure8:size=5`, `csv:FILE,place=as-is`."""

# Why: docs/decisions/vehicle-model.md#d20

import re
from collections.abc import Callable, Iterator
from pathlib import Path as FilePath

from steerd.car_model.path.path import Path
from steerd.car_model.path.path_csv import load_path
from steerd.car_model.path.path_shapes import (
    FIGURE_EIGHT_EXTENT,
    FIGURE_EIGHT_RADIUS,
    make_circle,
    make_figure_eight,
    make_line,
)

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
