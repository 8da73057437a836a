"""The map of an import: which column or topic of a log is which quantity.

One TOML page: `[columns]` for csv files, `[topics]` for ROS bags, `[frame]` where the recorded body
is not the car's centre of gravity, `[session]` for what the log does not say.
`docs/how-to/import-logs.md` explains it; `examples/import-*.toml` are whole ones.
"""

import datetime
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from steerd.daemon.common.errors import ExitCode, SteerdError, did_you_mean
from steerd.daemon.common.packaged import EXAMPLE_MAP
from steerd.daemon.settings.config import read_frame
from steerd.mocap_link.frame import FrameConfig
from steerd.steer_bus.topics import check_car_name
from steerd.toml_text import parse_toml, read_toml
from steerd.vesc_link.scaling import F1TENTH

NS = 1_000_000_000
STREAM_COLUMNS = (
    "x", "y", "yaw", "steer_cmd", "speed_cmd", "throttle", "wheel_speed", "erpm", "yaw_rate",
)  # fmt: skip
"""What a csv file can give besides `t`: metres, radians, seconds, m/s, electrical rpm."""
ROLES = ("pose", "command", "vesc", "wheel")
"""What a topic of a bag can be: wheel takes the forward speed out of an Odometry."""
_POSE = {"x", "y", "yaw"}
_HINT = f"copy {EXAMPLE_MAP} and edit it: its comments explain the map"


class ColumnSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One column: value = scale · cell + offset; 0 where the `gate` column is 0."""

    column: str
    scale: float = 1.0
    offset: float = 0.0
    gate: str | None = None


class VescSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the log's electrical rpm and the car's speed belong together; negative: wired so."""

    erpm_gain: float = F1TENTH.erpm_gain
    erpm_offset: float = 0.0

    def __post_init__(self) -> None:
        if not 1.0 <= abs(self.erpm_gain) <= 1e6 or not abs(self.erpm_offset) <= 1e6:
            raise ValueError("erpm_gain is the ERPM of 1 m/s, 4614 for an F1TENTH car")


class SessionSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the log does not hold: the car's name, the UNIX time of its time zero, a remark."""

    car: str = "car"
    epoch: float | datetime.datetime = 0.0
    comment: str = ""


class _Tables(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    columns: dict[str, str | ColumnSpec] = {}
    topics: dict[str, str] = {}
    rigid: int | None = None
    frame: dict[str, Any] | None = None
    vesc: VescSpec | None = None
    session: SessionSpec = SessionSpec()


@dataclass(frozen=True)
class ImportMap:
    """A map that was read and checked."""

    # Quantity to column, `t` included; empty in a map for bags
    columns: dict[str, ColumnSpec] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)  # role to topic
    rigid: int | None = None  # which body of a PhaseSpace message is the car; None: the only one
    # From the recorded body to the centre of gravity; None changes nothing
    frame: FrameConfig | None = None
    vesc: VescSpec | None = None  # ERPM per m/s and its offset; None for the F1TENTH figures
    car: str = "car"  # the car's name in topics
    epoch_ns: int = 0  # UNIX time of the log's time zero [ns]
    comment: str = ""  # a remark for `steerd info`
    text: str = ""  # the map's own text; it is kept inside the session
    name: str = "the map"  # what messages call it


def load_map(path: Path) -> ImportMap:
    """Read a map; a SteerdError where it is unreadable or says something impossible."""
    try:
        return replace(parse_map(read_toml(path)), name=f"map {path}")
    except OSError as error:
        what = f"map {path} cannot be read: {error.strerror}"
        raise SteerdError(what, "name a map with --map", ExitCode.UNREADABLE) from error
    except ValueError as error:
        raise SteerdError(f"map {path}: {error}", _HINT) from error


def parse_map(text: str) -> ImportMap:
    """Check the text of a map; a ValueError says in a line what makes no sense."""
    try:
        tables = msgspec.convert(parse_toml(text), _Tables)
        frame = None if tables.frame is None else read_frame(tables.frame)
    except msgspec.ValidationError as error:
        raise ValueError(_readable(str(error))) from error
    for role in tables.topics:
        _expect("topics", role, ROLES)
    return ImportMap(
        columns=_columns(tables.columns),
        topics=tables.topics,
        rigid=tables.rigid,
        frame=frame,
        vesc=tables.vesc,
        car=check_car_name(tables.session.car),
        epoch_ns=_epoch_ns(tables.session.epoch),
        comment=tables.session.comment,
        text=text,
    )


def _readable(text: str) -> str:
    """A msgspec message in TOML notation: `$.columns.t` becomes `[columns] t`."""
    text = re.sub(r" - at `key in \$(\.?)[^`]*`", "", text)
    text = re.sub(r" - at `\$\.(\w+)\.?([^`]*)`", r" in [\1] \2", text).replace("[...]", "a value")
    return text.replace("Object contains", "it has an").replace("`", "'").strip()


def _columns(columns: dict[str, str | ColumnSpec]) -> dict[str, ColumnSpec]:
    known = ("t", *STREAM_COLUMNS)
    made = {k: ColumnSpec(v) if isinstance(v, str) else v for k, v in columns.items()}
    for name, spec in made.items():
        _expect("columns", name, known)
        if not (math.isfinite(spec.scale) and math.isfinite(spec.offset)) or spec.scale == 0.0:
            raise ValueError(f"[columns] {name}: scale and offset must be finite, scale not 0")
    if made and "t" not in made:
        raise ValueError("[columns] lacks 't', the time")
    if made.keys() == {"t"}:
        raise ValueError("no column but the time has a meaning")
    pose = _POSE & made.keys()
    if pose and pose != _POSE:
        missing = ", ".join(sorted(_POSE - pose))
        raise ValueError(f"[columns] a pose needs x, y and yaw: {missing} missing")
    return made


def _expect(section: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        what = f"[{section}] {name!r} is none of {', '.join(known)}; {did_you_mean(name, known)}"
        raise ValueError(what.strip("; "))


def _epoch_ns(epoch: float | datetime.datetime) -> int:
    if isinstance(epoch, datetime.datetime):
        utc = epoch if epoch.tzinfo else epoch.replace(tzinfo=datetime.UTC)
        epoch = utc.timestamp()
    if not 0.0 <= epoch < 1 << 31:
        raise ValueError("[session] epoch must be UNIX seconds or a date from 1970 to 2037")
    return round(epoch * NS)
