"""A car file as everything that a drive needs: each section checked by the room that uses it."""

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from math import radians
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from steerd.car_model.car_file import CarFile, CarFileError, load_car
from steerd.car_model.params import wheelbase
from steerd.controller.config import ControllerConfig, load_controller_config
from steerd.controller.limits import Limits
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.translate import make_car_file_error
from steerd.daemon.settings.thresholds import Thresholds
from steerd.estimator.config import FilterConfig, load_filter_config
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.vesc_link.scaling import Scaling, steer_limits

S = TypeVar("S")
FLUSH_MS, DISK_FREE_MIN_MB = (10, 250), 100
"""What no car file may leave."""


@dataclass(frozen=True)
class BrakeSettings:
    """What stops the car, and what the VESC must do by itself. Currents in ampere.

    Attributes:
        brake_current_a: of a fault stop.
        soft_brake_current_a: at the end of an ordinary stop.
        hold_brake_current_a: while armed.
        estop_brake_current_a: of an emergency stop.
        timeout_max_ms: longest own timeout of the VESC that may be armed.
        current_max_a: motor current that counts as full.
        cells: of the battery in series.
        uuid: 24 hex digits of the VESC that must answer; empty takes any.
    """

    brake_current_a: float = 20.0
    soft_brake_current_a: float = 6.0
    hold_brake_current_a: float = 4.0
    estop_brake_current_a: float = 25.0
    timeout_max_ms: int = 200
    current_max_a: float = 60.0
    cells: int = 3
    uuid: str = ""


@dataclass(frozen=True)
class RecordSettings:
    """What the recorder must be able to do before the car may drive.

    Attributes:
        required: whether a lost recorder stops the car (W26); it keeps it from being armed too.
        flush_ms: at most so much of a session is lost when everything is killed; 10 to 250.
        disk_free_min_mb: less free space ends the recording in good order; at least 100.
    """

    required: bool = True
    flush_ms: int = 250
    disk_free_min_mb: int = 500


@dataclass(frozen=True)
class Settings:
    """Everything a car file says, validated."""

    file: CarFile
    scaling: Scaling
    brakes: BrakeSettings
    ingest: IngestConfig
    limits: Limits
    controller: ControllerConfig
    filter: FilterConfig
    thresholds: Thresholds
    deadman: bool
    record: RecordSettings


def load_settings(path: Path | str, speed: float | None = None) -> Settings:
    """Read a car file and check every section.

    Args:
        path: the TOML file.
        speed: cruise speed that replaces the file's [m/s].

    Raises:
        SteerdError: the file cannot be read, or a value in it cannot be; says which and what to do.
    """
    try:
        car_file = load_car(path)
    except CarFileError as error:
        raise make_car_file_error(error) from None
    return make_settings(car_file, speed)


def make_settings(car_file: CarFile, speed: float | None = None) -> Settings:
    """The settings of a car file that was read.

    Raises:
        SteerdError: a section holds something that cannot be.
    """
    take = _Sections(car_file)
    vesc = dict(take.section("vesc"))
    brakes = {k: vesc.pop(k) for k in list(vesc) if k in _names(BrakeSettings)}
    safety = dict(take.section("safety"))
    deadman = bool(safety.pop("deadman", True))
    control = dict(take.section("controller"))
    control.pop("rate_hz", None)
    if speed is not None:
        control["speed"] = speed
    scaling = take.make("vesc", lambda: _convert(vesc, Scaling))
    settings = Settings(
        file=car_file,
        scaling=scaling,
        brakes=take.make("vesc", lambda: _positive_brakes(_convert(brakes, BrakeSettings))),
        ingest=take.make("mocap", lambda: IngestConfig(_frame(car_file, take.section("mocap")))),
        limits=take.make("limits", lambda: _limits(car_file, scaling, take.section("limits"))),
        controller=take.make("controller", lambda: load_controller_config(control)),
        filter=take.make("estimator", lambda: load_filter_config(take.section("estimator"))),
        thresholds=take.make("safety", lambda: _thresholds(safety)),
        deadman=deadman,
        record=take.make("record", lambda: _record(take.section("record"))),
    )
    if settings.controller.speed > settings.limits.speed_max:
        raise SteerdError(
            f"{settings.controller.speed:g} m/s is above the car file's limits.speed_max = "
            f"{settings.limits.speed_max:g} m/s",
            "drive slower, or raise speed_max if the car may",
        )
    return settings


class _Sections:
    """The sections of one car file, each read at most by the room that owns it."""

    def __init__(self, car_file: CarFile) -> None:
        self._file = car_file

    def section(self, name: str) -> Mapping[str, Any]:
        table = self._file.sections.get(name, {})
        if not isinstance(table, Mapping):
            raise SteerdError(f"{self._file.path}: [{name}] must be a table")
        return table

    def make(self, name: str, make: Callable[[], S]) -> S:
        try:
            return make()
        except (ValueError, TypeError) as error:
            raise SteerdError(f"{self._file.path} [{name}]: {error}") from None


def _names(cls: type[Any]) -> tuple[str, ...]:
    return tuple(f.name for f in fields(cls))


def _convert(table: Mapping[str, Any], cls: type[S]) -> S:
    """A table as a dataclass; numbers must be numbers, names must be known."""
    known = _names(cls)
    for name in table:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise ValueError(f"{name} is not a setting; {hint}")
    return msgspec.convert(dict(table), cls)


def _positive_brakes(brakes: BrakeSettings) -> BrakeSettings:
    for name in _names(BrakeSettings)[:4]:
        if not 0.0 < getattr(brakes, name) <= 200.0:
            raise ValueError(f"{name} = {getattr(brakes, name)}: a stop needs a current above 0 A")
    if brakes.uuid and len(bytes.fromhex(brakes.uuid)) != 12:
        raise ValueError(f"uuid = {brakes.uuid!r}: 24 hex digits, as `steerd status` shows them")
    return brakes


def _record(table: Mapping[str, Any]) -> RecordSettings:
    record = _convert(table, RecordSettings)
    if not FLUSH_MS[0] <= record.flush_ms <= FLUSH_MS[1]:
        raise ValueError(f"flush_ms = {record.flush_ms}: {FLUSH_MS[0]} to {FLUSH_MS[1]} ms")
    if record.disk_free_min_mb < DISK_FREE_MIN_MB:
        text = f"disk_free_min_mb = {record.disk_free_min_mb}: at least {DISK_FREE_MIN_MB} MB"
        raise ValueError(text)
    return record


_FRAME_KEYS = {"world_yaw_deg": "world_yaw", "mount_yaw_deg": "mount_yaw"}


def _frame(car_file: CarFile, table: Mapping[str, Any]) -> FrameConfig:
    values = {
        _FRAME_KEYS.get(key, key): radians(value) if key in _FRAME_KEYS else value
        for key, value in table.items()
    }
    frame = _convert(values, FrameConfig)
    return replace(
        frame, cog_ahead_of_rear=car_file.car.lr, world_xy=(frame.world_xy[0], frame.world_xy[1])
    )


def _limits(car_file: CarFile, scaling: Scaling, table: Mapping[str, Any]) -> Limits:
    right, left = steer_limits(scaling)
    car = car_file.car
    defaults = {
        "steer_left_max": min(left, car.steer_max),
        "steer_right_max": min(-right, -car.steer_min),
    }
    values = {**defaults, **table, "wheelbase": wheelbase(car)}
    limits = _convert(values, Limits)
    return replace(
        limits,
        steer_left_max=min(limits.steer_left_max, defaults["steer_left_max"]),
        steer_right_max=min(limits.steer_right_max, defaults["steer_right_max"]),
    )


def _thresholds(table: Mapping[str, Any]) -> Thresholds:
    values = dict(table)
    if "fence" in values:
        values["fence"] = tuple((float(x), float(y)) for x, y in values["fence"])
    return _convert(values, Thresholds)
