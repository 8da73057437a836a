"""A csv file as a session: which cells make which message, and at which time.

Streams of different rates share a file: a row gives a sample of each stream that has a value in it.
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.packaged import EXAMPLE_MAP
from steerd.daemon.common.progress import Advance
from steerd.daemon.imports.csv_table import CsvTable, open_table
from steerd.daemon.imports.import_map import NS, ImportMap, load_map, with_erpm_gain
from steerd.daemon.imports.import_session import (
    ImportReport,
    MessageMaker,
    Sample,
    check_output,
    write_import,
)
from steerd.steer_bus.topics import ACTUATION, IMU, MOCAP, THROTTLE, VESC, WHEEL, Topic

_SINGLE: dict[str, tuple[Topic, Callable[[MessageMaker, int, float], Any]]] = {
    "erpm": (VESC, MessageMaker.telemetry),
    "wheel_speed": (WHEEL, MessageMaker.wheel),
    "throttle": (THROTTLE, MessageMaker.throttle),
    "yaw_rate": (IMU, MessageMaker.gyro),
}
"""Quantities that are a message each: its topic, and what makes it."""
_TOPICS = {"x": MOCAP, "steer_cmd": ACTUATION, "speed_cmd": ACTUATION}
_TOPICS |= {quantity: topic for quantity, (topic, _) in _SINGLE.items()}
_POSE = ("x", "y", "yaw")
_Timed = tuple[int, dict[str, float]]
"""The time of a row [ns], and the quantities that have a value in it."""
_INT32_MAX = (1 << 31) - 1  # largest UNIX time [s] and largest ERPM of a message


def import_csv(
    source: Path, map_path: Path, out: Path, advance: Advance, erpm_gain: float | None = None
) -> ImportReport:
    """Turn a csv file into a session.

    Args:
        source: the csv file; its delimiter is detected.
        map_path: the map, with `[columns]`.
        out: the session to write; nothing is left of it after an error.
        advance: called with the bytes read so far.
        erpm_gain: electrical rpm per m/s; None for the map's.

    Raises:
        SteerdError: something is wrong with the map, the file or the output; the message says
            where.
    """
    check_output(out)
    the_map = load_map(map_path)
    if not the_map.columns:
        hint = f"copy {EXAMPLE_MAP} and name your columns"
        raise SteerdError(f"map {map_path} has no [columns]", hint)
    the_map = replace(the_map, vesc=with_erpm_gain(the_map.vesc, erpm_gain))
    notes: Counter[str] = Counter()
    topics = list(dict.fromkeys(_TOPICS[q] for q in the_map.columns if q in _TOPICS))
    with open_table(source) as file:
        table = CsvTable(source.name, file, {spec.column for spec in the_map.columns.values()})
        the_map, timed = _raise_epoch(the_map, _add_times(table, the_map, notes, advance))
        samples = _samples(table, timed, the_map, notes)
        return write_import(out, source, the_map, topics, samples, notes)


def _add_times(
    table: CsvTable, the_map: ImportMap, notes: Counter[str], advance: Advance
) -> Iterator[_Timed]:
    """Rows with their times [ns], which never go back."""
    column = the_map.columns["t"].column
    last_ns, last_row = None, 0
    for values in table.rows(the_map.columns, advance):
        if "t" not in values:
            table.fail("no time, but other values", column=column)
        t = values["t"]
        if abs(t + the_map.epoch_ns / NS) > _INT32_MAX:
            hint = "scale = 0.001 in the map for milliseconds, 1e-9 for nanoseconds"
            table.fail(f"{t:g} s is no time", hint, column)
        t_ns = _nanoseconds(t)
        if last_ns is not None and t_ns < last_ns:
            what = f"time goes back by {(last_ns - t_ns) / NS:g} s after row {last_row}"
            table.fail(what, "sort the rows, or import each run by itself", column)
        if t_ns == last_ns:
            notes["rows repeat the time of the row before"] += 1
        last_ns, last_row = t_ns, table.row
        yield t_ns, values


def _nanoseconds(t: float) -> int:
    whole = math.floor(t)  # separately, so that UNIX seconds lose no digit
    return whole * NS + round((t - whole) * NS)


def _raise_epoch(the_map: ImportMap, timed: Iterator[_Timed]) -> tuple[ImportMap, Iterator[_Timed]]:
    """Raise the epoch if the log begins before 1970: a session's stamps are not negative."""
    first = next(timed, None)
    if first is None:
        return the_map, timed
    epoch_ns = max(the_map.epoch_ns, -first[0])
    return replace(the_map, epoch_ns=epoch_ns), itertools.chain([first], timed)


def _samples(
    table: CsvTable, timed: Iterator[_Timed], the_map: ImportMap, notes: Counter[str]
) -> Iterator[Sample]:
    maker = MessageMaker(the_map.epoch_ns, the_map.frame)
    for t_ns, v in timed:
        if _POSE[0] in v and _POSE[1] in v and _POSE[2] in v:
            yield Sample(MOCAP, t_ns, t_ns, maker.planar_pose(t_ns, v["x"], v["y"], v["yaw"]))
        elif any(key in v for key in _POSE):
            notes["rows hold a part of a pose and were left out of it"] += 1
        if "steer_cmd" in v or "speed_cmd" in v:
            steer, speed = v.get("steer_cmd", math.nan), v.get("speed_cmd", math.nan)
            yield Sample(ACTUATION, t_ns, t_ns, maker.command(t_ns, steer, speed))
        if abs(v.get("erpm", 0.0)) > _INT32_MAX:
            column = the_map.columns["erpm"].column
            table.fail(f"{v['erpm']:g} is no motor speed", column=column)
        for name, (topic, make) in _SINGLE.items():
            if name in v:
                yield Sample(topic, t_ns, t_ns, make(maker, t_ns, v[name]))
