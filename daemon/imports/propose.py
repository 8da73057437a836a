"""A map proposed from a log itself: what its columns or topics probably are, and in which unit.

A proposal is a guess; `steerd import --ask` shows what it would mean before anything is written.
"""

import csv
import itertools
import re
from collections.abc import Iterable, Mapping
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from steerd.daemon.imports.csv_table import open_table, read_header
from steerd.daemon.imports.import_map import ROLES, STREAM_COLUMNS

Proposal = dict[str, dict[str, Any]]
"""Sections of a map."""
_ROWS = 20_000
"""Rows that are looked at."""
_NAMES: tuple[tuple[str, str], ...] = (
    ("t", r"^#?\s*(t|time|stamp|sec|secs|seconds)$|time|stamp"),
    ("yaw_rate", r"yaw_?rate|gyro.*z|imu.*wz|^wz$|omega|^r$|angular.*z"),
    ("yaw", r"^yaw|heading|theta|psi|yaw$"),
    ("x", r"^(x|px|pos_?x)$|(^|[_. /])x(_?m+)?$|position.*x"),
    ("y", r"^(y|py|pos_?y)$|(^|[_. /])y(_?m+)?$|position.*y"),
    ("steer_cmd", r"steer|delta"),
    ("erpm", r"erpm|(^|_)rpm"),
    ("speed_cmd", r"(speed|vel|v).*(cmd|ref|set|des|target)|(cmd|ref|set|des|target).*(speed|vel)"),
    ("throttle", r"throttle|gas|duty"),
    ("wheel_speed", r"wheel|enc|odom.*v|vesc.*v|^v$|^vx$|speed|vel"),
)
"""Quantity and the names that its column often has; the first fit takes the column."""
_LINE = re.compile(r"^\s*([\w.]+)\s*=\s*(.*?)\s*(?:\*\s*([-+\d.eE]+))?\s*$")


def propose_csv(source: Path) -> Proposal:
    """Columns of a table, with the scales that make them SI.

    Raises:
        SteerdError: the file cannot be read.
    """
    with open_table(source) as file:
        delimiter, header = read_header(source.name, file)
        rows = csv.reader(file, delimiter=delimiter, skipinitialspace=True)
        texts = list(itertools.islice(rows, _ROWS))
    columns: dict[str, Any] = {}
    free = list(header)
    for quantity, pattern in _NAMES:
        fits = [name for name in free if re.search(pattern, name, re.IGNORECASE)]
        if fits:
            free.remove(fits[0])
            values = _numbers(texts, header.index(fits[0]), delimiter)
            scale = guess_scale(quantity, values)
            named: Any = fits[0]
            columns[quantity] = named if scale == 1.0 else {"column": named, "scale": scale}
    if not {"x", "y", "yaw"} <= columns.keys():
        columns = {k: v for k, v in columns.items() if k not in ("x", "y", "yaw")}
    return {"columns": columns}


def _numbers(texts: Iterable[list[str]], index: int, delimiter: str) -> NDArray[np.float64]:
    found = []
    for row in texts:
        text = row[index].strip() if index < len(row) else ""
        try:
            found.append(float(text.replace(",", ".") if delimiter == ";" else text))
        except ValueError:
            continue
    values = np.array(found, dtype=np.float64)
    return np.asarray(values[np.isfinite(values)])


def guess_scale(quantity: str, values: NDArray[np.float64]) -> float:
    """What makes a column SI, by the size of its numbers; 1 where they look so already."""
    if values.size < 2:
        return 1.0
    worst = float(np.quantile(np.abs(values), 0.99))
    match quantity:
        case "t":
            step = float(np.median(np.abs(np.diff(values))))
            for low, scale in ((1e5, 1e-9), (300.0, 1e-6), (0.9, 1e-3)):
                if step > low:
                    return scale
        case "x" | "y" if worst > 100.0:
            return 0.001
        case "yaw" if worst > 12.0 * pi or (worst > 1.1 * pi and _is_wrapped(values, 180.0)):
            return round(pi / 180.0, 10)
        case "steer_cmd" if worst > pi / 2:
            return round(pi / 180.0, 10)
        case "yaw_rate" if worst > 15.0:
            return round(pi / 180.0, 10)
        case "speed_cmd" | "wheel_speed" if worst > 100.0:
            return 0.001
    return 1.0


def _is_wrapped(values: NDArray[np.float64], half: float) -> bool:
    """Whether an angle jumps by a whole turn of that size."""
    jumps = np.abs(np.diff(values))
    return bool(np.any((jumps > 1.9 * half) & (jumps < 2.0 * half)))


def change(proposal: Proposal, line: str) -> str:
    """Change a proposal by a line that somebody typed.

    Args:
        proposal: is changed in place.
        line: `yaw = heading * 0.01745`, `pose = /vrpn/car/pose`, `erpm_gain = -7300`,
            `units = mm`; nothing after the `=` takes an entry away.

    Returns:
        What is wrong with the line; empty if it was taken.
    """
    found = _LINE.match(line)
    if found is None:
        return "NAME = COLUMN [* SCALE], for instance yaw = heading * 0.01745"
    name, value, scale = found.groups()
    sections = list_sections(proposal)
    if name not in sections:
        return f"{name}: one of {', '.join(sections)}"
    section = sections[name]
    table = proposal.setdefault(section, {})
    if not value:
        table.pop(name, None)
        return ""
    try:
        factor = 1.0 if scale is None else float(scale)
        if section == "columns":
            table[name] = value if factor == 1.0 else {"column": value, "scale": factor}
        else:
            table[name] = float(value) if section == "vesc" else value
    except ValueError:
        return f"{value or scale}: not a number"
    return ""


def list_sections(proposal: Mapping[str, Any]) -> dict[str, str]:
    """What a line of `change` may begin with, and the map's section that it stands in."""
    own = dict.fromkeys(("t", *STREAM_COLUMNS), "columns")
    if "columns" not in proposal:
        own = dict.fromkeys(ROLES, "topics")
    frame = dict.fromkeys(("units", "up", "body_forward"), "frame")
    return {**own, "erpm_gain": "vesc", **frame, "car": "session"}


def format_map(proposal: Proposal, source: str) -> str:
    """The proposal as the text of a map."""
    document = tomlkit.document()
    document.add(tomlkit.comment(f"Which quantity is what in {source}; value = scale * cell."))
    for section, table in proposal.items():
        if not table:
            continue
        shown = tomlkit.table()
        for key, value in table.items():
            if isinstance(value, dict):
                inline = tomlkit.inline_table()
                inline.update(value)
                shown[key] = inline
            else:
                shown[key] = value
        document[section] = shown
    return tomlkit.dumps(document)
