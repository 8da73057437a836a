"""A car file as settings: each section is checked by the room that uses it."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from math import pi, radians
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from steerd.car_model.car_file import CarFile
from steerd.car_model.model import Model, believed_car, car_now, memory_size, model_rates, observe
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import GRAVITY, wheelbase
from steerd.car_model.state import ORIGIN, State
from steerd.controller.config import ControllerConfig, load_controller_config
from steerd.controller.limits import Limits
from steerd.daemon.common.errors import (
    ExitCode,
    SteerdError,
    did_you_mean,
    find_near,
    load_car_file,
    refusing,
)
from steerd.daemon.settings.thresholds import LAUNCH_RATIO, LAUNCH_SPEED, SOFT_DECEL, Thresholds
from steerd.estimator.config import FilterConfig, load_filter_config
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.gates import GateConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.vesc_link.scaling import Scaling, steer_limits

S = TypeVar("S")
FLUSH_MS_MIN, FLUSH_MS_MAX = 10, 250
"""Range of `[record] flush_ms` [ms]: rarer loses too much, more often costs too much."""
DISK_FREE_MIN_MB = 100  # least `[record] disk_free_min_mb` [MB]
BRAKE_CURRENT_MAX_A = 200.0  # largest brake current that a car file may give [A]
UUID_BYTES = 12  # length of a VESC's UUID


@dataclass(frozen=True)
class BrakeSettings:
    """Brake currents [A], and what the VESC must do by itself."""

    brake_current_a: float = 20.0  # of a fault stop
    soft_brake_current_a: float = 6.0  # at the end of an ordinary stop
    hold_brake_current_a: float = 4.0  # while armed
    estop_brake_current_a: float = 25.0  # of an emergency stop
    timeout_max_ms: int = 200  # longest timeout of the VESC with which the car may be armed [ms]
    current_max_a: float = 60.0  # motor current that counts as full [A]
    cells: int = 3  # number of battery cells in series
    uuid: str = ""  # 24 hex digits of the VESC that must answer; empty takes any

    def __post_init__(self) -> None:
        for name in (each for each in _names(type(self)) if each.endswith("brake_current_a")):
            value = getattr(self, name)
            if not 0.0 < value <= BRAKE_CURRENT_MAX_A:
                raise ValueError(f"{name} = {value}: a stop needs a current above 0 A")
        if self.uuid and len(bytes.fromhex(self.uuid)) != UUID_BYTES:
            raise ValueError(f"uuid = {self.uuid!r}: 24 hex digits, as `steerd status` shows them")


@dataclass(frozen=True)
class RecordSettings:
    """Requirements on the recorder."""

    required: bool = True  # whether a lost recorder stops the car, and prevents arming (W26)
    flush_ms: int = 250  # time between writes to the disk [ms], which a killed recorder loses
    disk_free_min_mb: int = 500  # less free space [MB] ends the recording; the file stays complete

    def __post_init__(self) -> None:
        if not FLUSH_MS_MIN <= self.flush_ms <= FLUSH_MS_MAX:
            raise ValueError(f"flush_ms = {self.flush_ms}: {FLUSH_MS_MIN} to {FLUSH_MS_MAX} ms")
        if self.disk_free_min_mb < DISK_FREE_MIN_MB:
            text = f"disk_free_min_mb = {self.disk_free_min_mb}: at least {DISK_FREE_MIN_MB} MB"
            raise ValueError(text)


@dataclass(frozen=True)
class Settings:
    """A car file with every section checked."""

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


JUMP_SDS = 7.0  # standard deviations of a pose by which two may differ: five of their difference


def load_settings(path: Path | str | None, speed: float | None = None) -> Settings:
    """Read a car file, F1TENTH's for None, and check every section.

    `speed` [m/s] replaces the file's cruise speed.

    Raises:
        SteerdError: the file cannot be read, or a value is invalid; names it and the remedy.
    """
    return make_settings(load_car_file(path), speed)


def make_settings(car_file: CarFile, speed: float | None = None) -> Settings:
    """The settings of a car file that was read.

    Raises:
        SteerdError: a section or a key is mistyped, a value is invalid, or two contradict.
    """
    for name in car_file.sections:  # one that is named nearly as another: its limits would not hold
        near = find_near(name, _SECTIONS)
        if name not in _SECTIONS and near:
            what = f"{car_file.path}: [{name}] is not a section that steerd reads"
            raise SteerdError(what, f"did you mean [{near}]?")
    read = partial(_read, car_file)
    scaling = read("vesc", lambda table: _convert(table, Scaling, _names(BrakeSettings)))
    frame, noise = read("mocap", read_frame), read("estimator", load_filter_config)
    usual = GateConfig()
    gates = replace(
        usual,
        jump_slack=max(usual.jump_slack, JUMP_SDS * noise.pose_position_sd),
        yaw_slack=max(usual.yaw_slack, JUMP_SDS * noise.pose_yaw_sd),
    )
    settings = Settings(
        file=car_file,
        scaling=scaling,
        brakes=read("vesc", lambda table: _convert(table, BrakeSettings, _names(Scaling))),
        ingest=IngestConfig(replace(frame, cog_ahead_of_rear=car_file.car.lr), gates),
        limits=read("limits", lambda table: _limits(car_file, scaling, table)),
        controller=_at_speed(car_file, speed),
        filter=noise,
        thresholds=read("safety", lambda table: _convert(table, Thresholds, ("deadman",))),
        deadman=bool(read("safety", dict).get("deadman", True)),
        record=read("record", lambda table: _convert(table, RecordSettings)),
    )
    for wrong, what, hint in _list_contradictions(settings):
        if wrong:
            raise SteerdError(what, hint)
    return settings


_SECTIONS = (
    "car", "effects", "vesc", "mocap", "limits", "controller", "estimator", "record", "safety",
    "noise", "knowledge",
)  # fmt: skip
"""Sections that some room reads; others are a reader's own and stay."""


_Contradiction = tuple[bool, str, str]  # whether it is there, what it is, and what to try


def _list_contradictions(s: Settings) -> Iterator[_Contradiction]:
    """What would end each of a car's drives, by a watchdog (W20, W24), its launch or its limits."""
    th, path, car = s.thresholds, s.file.path, believed_car(s.file.model)
    needed, given = th.stop_share * th.brake_decel, car.mu * GRAVITY
    what = f"{path}: friction {car.mu:g} stops the car with {given:.2f} m/s² at most; "
    what += f"[safety] expects {needed:.2f} m/s² (stop_share x brake_decel)"
    yield given < needed, what, "measure brake_decel on this floor, and [car] mu"
    what = f"{path}: the drive's dead time of {car.drive_delay:g} s is longer than "
    what += f"[safety] stop_lag = {th.stop_lag:g} s, after which a stop must show"
    yield car.drive_delay > th.stop_lag, what, "measure drive_delay; stop_lag may be 0.3 s at most"
    slow, gain, (low, high) = min(LAUNCH_SPEED, s.limits.speed_max), car.speed_gain, LAUNCH_RATIO
    high = min(high, max(th.overspeed_ratio, 1.0 + th.overspeed_margin / slow))
    what = f"{path}: this car drives at {gain:g} times the speed of its wheels (speed_gain, "
    what += f"and the effects that change it); a start lets {low:g} to {high:g} pass"
    hint = f"[vesc] erpm_gain = {s.scaling.erpm_gain / gain:.0f} and speed_gain = 1 say the same"
    yield not low <= gain <= high, what, hint
    if s.file.model.effects:
        yield from _list_effects(s.file, th)
    speed, most = s.controller.speed, s.limits.speed_max
    what = f"{speed:g} m/s is above the car file's limits.speed_max = {most:g} m/s"
    yield speed > most, what, "drive slower, or raise speed_max if the car may"


def _read(car_file: CarFile, name: str, make: Callable[[Mapping[str, Any]], S]) -> S:
    """A section as what a room makes of it; what it refuses is said with file and section."""
    table = car_file.sections.get(name, {})
    if not isinstance(table, Mapping):
        raise SteerdError(f"{car_file.path}: [{name}] must be a table")
    try:
        return make(table)
    except (ValueError, TypeError) as error:
        raise SteerdError(f"{car_file.path} [{name}]: {error}") from None


def _at_speed(car_file: CarFile, speed: float | None) -> ControllerConfig:
    """The file's controller at the speed asked for; `rate_hz` of older files was never used."""
    config = _read(
        car_file, "controller",
        lambda table: load_controller_config({k: v for k, v in table.items() if k != "rate_hz"}),
    )  # fmt: skip
    with refusing("--speed: ", code=ExitCode.INVALID):
        return config if speed is None else replace(config, speed=speed)


def _names(cls: type[Any]) -> tuple[str, ...]:
    return tuple(f.name for f in fields(cls))


def _convert(table: Mapping[str, Any], cls: type[S], others: Collection[str] = ()) -> S:
    """A table as a dataclass; numbers must be numbers, names must be known, here or to `others`."""
    known, own = _names(cls), {name: table[name] for name in table if name not in others}
    for name in own:
        if name not in known:
            hint = did_you_mean(name, known) or f"known are {', '.join(known)}"
            raise ValueError(f"{name} is not a setting; {hint}")
    return msgspec.convert(own, cls)


FRAME_ANGLES = ("world_yaw", "mount_yaw")  # of a `FrameConfig`; tables give degrees, as `NAME_deg`


def read_frame(table: Mapping[str, Any]) -> FrameConfig:
    """Room and body, as `[mocap]` of a car file and `[frame]` of an import's map say them.

    Raises:
        ValueError: a key or a value is none.
    """
    angles = {f"{name}_deg": name for name in FRAME_ANGLES}
    values = dict(table)
    for name in angles.keys() & table.keys():
        value = values.pop(name)
        values[angles[name]] = radians(value) if isinstance(value, int | float) else value
    return _convert(values, FrameConfig)


def _limits(car_file: CarFile, scaling: Scaling, table: Mapping[str, Any]) -> Limits:
    right, left = steer_limits(scaling)
    car = car_file.car
    end_stops = {
        "steer_left_max": min(left, car.steer_max),
        "steer_right_max": min(-right, -car.steer_min),
    }
    limits = _convert({**end_stops, **table, "wheelbase": wheelbase(car)}, Limits)
    return replace(limits, **{k: min(getattr(limits, k), most) for k, most in end_stops.items()})


HEADING_MOST = 0.1
"""Heading error of the poses beyond which W5 stops a drive [rad]; 0.15 stopped, 0.1 did not."""
_HEADINGS = 24  # headings at which a car is let roll
_FAR = 1e6  # away from places that differ from the rest of the floor [m]


def _list_effects(file: CarFile, th: Thresholds) -> Iterator[_Contradiction]:
    """Effects that keep a car from stopping, from starting, or from being seen right.

    What they do is asked of the car's own equations, so that no effect is named here.
    """
    rolling = [_roll(file.model, 2.0 * pi * k / _HEADINGS) for k in range(_HEADINGS)]
    most = (1.0 - th.stop_share) * SOFT_DECEL
    what = f"{file.path}: left to roll, this car speeds up by {max(rolling):.2f} m/s² "
    what += f"([effects]); with more than {most:.2f} a stop is not distinguishable from none"
    yield max(rolling) > most, what, "measure that floor or that drag; no stop is sure on it"
    lack = -min(rolling) * believed_car(file.model).speed_lag
    allowed = th.follow_share * LAUNCH_SPEED
    what = f"{file.path}: this car lags {lack:.2f} m/s behind its orders ([effects], speed_lag); "
    what += f"W30 lets {allowed:.2f} pass at a start"
    hint = "identify speed_lag and drag; a tight speed loop has no such lag"
    yield lack > allowed * (1.0 + 1e-6), what, hint
    off = observe(FLOAT, file.model, _at(0.0)).yaw
    what = f"{file.path}: mocap shows a heading {off:+.2f} rad off the car's ([effects])"
    hint = "turn the body by [mocap] mount_yaw_deg: `steerd mocap calibrate`"
    yield abs(off) > HEADING_MOST, what, hint


def _at(heading: float) -> State[float]:
    return ORIGIN._replace(x=_FAR, y=_FAR, yaw=heading, speed=1.0)


def _roll(model: Model[float], heading: float) -> float:
    """Acceleration of a car that rolls straight on [m/s^2]."""
    state = _at(heading)
    car = car_now(FLOAT, model, state, 0.0)
    memory = (0.0,) * memory_size(model.effects)
    return model_rates(FLOAT, model, car, memory, state, 0.0, 0.0).speed
