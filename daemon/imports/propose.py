"""A map proposed from a log itself: what its columns or topics probably are, and in which unit.

A proposal is a guess; `steerd import --ask` shows what it would mean before anything is written.
"""

import itertools
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from math import inf, pi
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.imports.csv_log import CsvTable, open_table
from steerd.daemon.imports.import_map import ROLES, STREAM_COLUMNS

Proposal = dict[str, dict[str, Any]]  # sections of a map
_ROWS = 20_000  # rows that are looked at
_DEGREE = round(pi / 180.0, 10)
_QUANTITIES: dict[str, tuple[str, float, float]] = {
    "t": (r"^#?\s*(t|time|stamp|sec|secs|seconds)$|time|stamp", inf, 1.0),
    "yaw_rate": (r"yaw_?rate|gyro.*z|imu.*wz|^wz$|omega|^r$|angular.*z", 15.0, _DEGREE),
    "yaw": (r"^yaw|heading|theta|psi|yaw$", 12.0 * pi, _DEGREE),
    "x": (r"^(x|px|pos_?x)$|(^|[_. /])x(_?m+)?$|position.*x", 100.0, 1e-3),
    "y": (r"^(y|py|pos_?y)$|(^|[_. /])y(_?m+)?$|position.*y", 100.0, 1e-3),
    "steer_cmd": (r"steer|delta", pi / 2, _DEGREE),
    "erpm": (r"erpm|(^|_)rpm", inf, 1.0),
    "speed_cmd": (
        r"(speed|vel|v).*(cmd|ref|set|des|target)|(cmd|ref|set|des|target).*(speed|vel)",
        100.0, 1e-3,
    ),
    "throttle": (r"throttle|gas|duty", inf, 1.0),
    "wheel_speed": (r"wheel|enc|odom.*v|vesc.*v|^v$|^vx$|speed|vel", 100.0, 1e-3),
}  # fmt: skip
"""Of each quantity: the names that its column often has, of which the first fit takes the column;
the largest size that is plausible in SI; the scale that makes larger numbers SI."""
_TICKS = ((1e5, 1e-9), (300.0, 1e-6), (0.9, 1e-3))
"""Time steps above these are of a finer unit [-], and its scale."""
_LINE = re.compile(r"^\s*([\w.]+)\s*=\s*(.*?)\s*(?:\*\s*([-+\d.eE]+))?\s*$")


def propose_csv(source: Path) -> Proposal:
    """Columns of a table, with the scales that make them SI.

    Raises:
        SteerdError: the file cannot be read.
    """
    with open_table(source) as file:
        table = CsvTable(source.name, file)
        rows = list(itertools.islice(table.texts(), _ROWS))
    columns: dict[str, Any] = {}
    free = list(table.header)
    for quantity, (pattern, _, _) in _QUANTITIES.items():
        fits = [name for name in free if re.search(pattern, name, re.IGNORECASE)]
        if fits:
            free.remove(fits[0])
            scale = guess_scale(quantity, _numbers(table, rows, table.header.index(fits[0])))
            columns[quantity] = scaled(fits[0], scale)
    if not {"x", "y", "yaw"} <= columns.keys():
        columns = {k: v for k, v in columns.items() if k not in ("x", "y", "yaw")}
    return {"columns": columns}


def scaled(column: str, scale: float) -> Any:
    """A column in a map, with its scale where it has one."""
    if scale == 1.0:
        return column
    table = tomlkit.inline_table()
    table.update(column=column, scale=scale)
    return table


def _numbers(table: CsvTable, rows: Iterable[list[str]], column: int) -> NDArray[np.float64]:
    found = []
    for texts in rows:
        with suppress(SteerdError):  # a cell that is no number does not decide about a unit
            found.append(table.number(texts, column))
    return np.array([value for value in found if value is not None], dtype=np.float64)


def guess_scale(quantity: str, values: NDArray[np.float64]) -> float:
    """What makes a column SI, by the size of its numbers; 1 where they look so already."""
    if values.size < 2:
        return 1.0
    if quantity == "t":
        step = float(np.median(np.abs(np.diff(values))))
        return next((scale for low, scale in _TICKS if step > low), 1.0)
    _, most, scale = _QUANTITIES[quantity]
    worst = float(np.quantile(np.abs(values), 0.99))
    jumps = np.abs(np.diff(values))
    turns = np.any((jumps > 0.95 * 360.0) & (jumps < 360.0))  # a heading in degrees is wrapped
    return scale if worst > most or (quantity == "yaw" and worst > 1.1 * pi and turns) else 1.0


def change(proposal: Proposal, line: str) -> str:
    """Change a proposal by a line that somebody typed; what is wrong with it, or nothing.

    Such as `yaw = heading * 0.01745`, `pose = /vrpn/car/pose`, `erpm_gain = -7300`, `units = mm`;
    nothing after the `=` takes an entry away.
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
        factor = float(scale or 1.0)
        if section == "columns":
            table[name] = scaled(value, factor)
        else:
            table[name] = float(value) if section == "vesc" else value
    except ValueError:
        return f"{value}: not a number"
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
    head = f"# Which quantity is what in {source}; value = scale * cell.\n"
    return head + tomlkit.dumps({name: table for name, table in proposal.items() if table})
