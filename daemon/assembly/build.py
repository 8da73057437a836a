"""Putting a run together: settings, path, design, loop and links."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from steerd.car_model.car_file import CarFile, default_car_path
from steerd.car_model.model import believed_car
from steerd.car_model.native.library import load_library
from steerd.car_model.params import Car
from steerd.car_model.path.path import Path
from steerd.car_model.path.path_spec import parse_path
from steerd.daemon.assembly.plans import Drill, parse_drill
from steerd.daemon.assembly.sim_car import load_sim_car, make_true_model
from steerd.daemon.common.errors import SteerdError, UsageError, find_near, refusing
from steerd.daemon.common.screen import print_labelled
from steerd.daemon.settings.config import Settings, load_settings, make_settings
from steerd.daemon.settings.run_options import (
    ControllerKind,
    RunOptions,
    decode_options,
    encode_options,
)
from steerd.steer_bus.topics import check_car_name

# The loop takes half a second to import. `steerd run` leaves it to the core's process, which needs
# it anyway; its terminal and its children start without. A core needs no simulated hardware.
if TYPE_CHECKING:
    from steerd.controller.acceptance import Acceptance
    from steerd.controller.config import ControllerConfig
    from steerd.controller.lane_controller import LaneController
    from steerd.controller.live import LiveBounds
    from steerd.sim_hw.world import WorldConfig

NS = 1_000_000_000  # nanoseconds in a second
FASTEST_HZ = 1000.0  # highest control rate [Hz]
SLOWEST_HZ, SLOWEST_SIMULATED_HZ = 50.0, 20.0
"""Lowest control rates [Hz]: the guardian brakes a car whose core has not ticked for 30 ms, and a
simulated one for 300 ms."""
OFFSET_SHARE = 0.5  # the lane may be shifted by this share of the error that stops the car (W17)
VIRTUAL_EPOCH_NS = 1_700_000_000_000_000_000
"""UNIX time at which every drive in virtual time begins: the same drive has the same bytes."""


class RunId(NamedTuple):
    """What two runs of the same plan differ in."""

    boot_id: int  # which operators must name
    epoch_ns: int  # UNIX time minus monotonic time [ns]
    leased: bool  # whether an operator's lease is needed


@dataclass(frozen=True)
class RunPlan:
    """A validated run that is ready to start."""

    options: RunOptions
    settings: Settings
    path: Path
    drill: Drill | None = None
    drawn: Settings | None = None  # of the simulated car, where a sweep drew one
    real: RunId | None = None  # of a drive in real time; None in virtual time

    @cached_property
    def run(self) -> RunId:
        """Which run of the plan this is."""
        return self.real or RunId(self.options.seed + 1, VIRTUAL_EPOCH_NS, leased=False)

    @cached_property
    def controller(self) -> LaneController:
        """The lane keeper, designed for this run once.

        Raises:
            SteerdError: the design is refused, with the reason.
        """
        from steerd.controller.design import DesignRefused

        car, config = make_design_car(self.settings), self.settings.controller
        try:
            return _design(car, self.path, config, self.options.rate_hz)
        except DesignRefused as error:
            raise SteerdError(str(error)) from None
        except ValueError as error:
            raise SteerdError(f"--path {self.options.path}: {error}") from None

    @cached_property
    def live(self) -> LiveBounds | None:
        """Bounds of live parameters; None unless the lane keeper drives alone, in real time."""
        from steerd.controller.live import make_live_bounds

        options, made = self.options, self.controller
        alone = options.controller is ControllerKind.LANE and self.drill is None
        if options.port is None or not alone:
            return None
        most = OFFSET_SHARE * self.settings.thresholds.lateral
        car, timing = made.car, made.report.timing
        return make_live_bounds(car, self.path, made.config, made.table, timing, most)

    @cached_property
    def learnt(self) -> Acceptance | None:
        """What designs of the learner are compared with; None without `--adapt`."""
        from steerd.controller.acceptance import make_acceptance

        return make_acceptance(self.controller) if self.options.adapt else None

    @cached_property
    def sim(self) -> Settings:
        """The settings of the simulated car; those of the car file unless `--sim-car` differs.

        Raises:
            SteerdError: the simulated car's file is refused.
        """
        spec = self.options.sim_car
        return self.drawn or (load_sim_car(spec) if spec else self.settings)

    @cached_property
    def period_ns(self) -> int:
        """Period of the control loop [ns]."""
        return round(NS / self.options.rate_hz)

    @cached_property
    def duration_ns(self) -> int | None:
        """Length of the drive [ns]; None without end."""
        return None if self.options.duration_s is None else round(self.options.duration_s * NS)

    @cached_property
    def remote(self) -> bool:
        """Whether commands come from an external controller."""
        return self.options.controller is not ControllerKind.LANE

    @cached_property
    def ignores_lane(self) -> bool:
        """Whether lane errors do not count: something else than the lane keeper drives."""
        return self.remote or (self.drill is not None and not self.drill.closed)


_KEPT = 8  # paths and designs that a process keeps: many drives in a row use few, in turn
_parse_shape = lru_cache(_KEPT)(parse_path)  # the same value each time, so that its design is too


@lru_cache(_KEPT)
def _design(
    car: Car[float], path: Path, config: ControllerConfig, rate_hz: float
) -> LaneController:
    from steerd.controller.build import make_controller

    return make_controller(car, path, config, rate_hz)


def make_plan(
    options: RunOptions,
    settings: Settings | None = None,
    *,
    design: bool = True,
    real: RunId | None = None,
) -> RunPlan:
    """Read the car file (unless its settings are given), the path, and design the controller.

    A drive of an excitation plan is as long as that, unless the options say how long.
    `design`: False where another process will do that; `real`: of a drive in real time.

    Raises:
        SteerdError: any of them is refused, with the reason.
        LibraryError: the compiled equations were not built.
    """
    slowest = SLOWEST_HZ if options.port and not options.simulated else SLOWEST_SIMULATED_HZ
    if not slowest <= options.rate_hz <= FASTEST_HZ:
        raise UsageError(f"--rate {options.rate_hz:g}: {slowest:g} to {FASTEST_HZ:g} Hz")
    with refusing("--name: "):
        check_car_name(options.car)
    if settings is None:
        settings = load_settings(options.car_file or default_car_path(), options.speed)
    is_file = options.path.strip().startswith("csv:")
    try:
        path = parse_path(options.path) if is_file else _parse_shape(options.path)
    except ValueError as error:
        raise UsageError(f"--path {options.path}: {error}", _near_path(options.path)) from None
    drill = None
    if options.drill:
        with refusing():
            drill = parse_drill(options.drill, settings.file.car, settings.limits)
        if drill.box is not None:  # the drill's box is the fence
            limited = replace(settings.thresholds, fence=drill.box.fence)
            settings = replace(settings, thresholds=limited)
        if options.duration_s is None:
            options = replace(options, duration_s=drill.seconds)
    plan = RunPlan(options, settings, path, drill, real=real)
    load_library()  # a missing one is said here, before any process is started
    if design:
        _ = plan.controller
    return plan


def make_job(plan: RunPlan) -> dict[str, Any]:
    """What a process of the run makes its own plan of (`read_job`), as JSON values."""
    return {"options": encode_options(plan.options), "run": plan.run}


def read_job(job: Mapping[str, Any], *, design: bool = False) -> RunPlan:
    """The plan of a job, in the process that was given it; raises as `make_plan`."""
    return make_plan(decode_options(job["options"]), design=design, real=RunId(*job["run"]))


_SHAPES = ("line", "circle", "figure8", "csv")
_SHAPE_OPTIONS = ("length", "radius", "dir", "size", "place", "smooth")


def _near_path(spec: str) -> str:
    """The path that was perhaps meant: the same words, mistyped ones replaced."""
    shape, colon, rest = spec.partition(":")
    if shape != "csv" or not rest:
        words = [word.partition("=") for word in rest.split(",")]
        rest = ",".join((find_near(k, _SHAPE_OPTIONS) or k) + eq + value for k, eq, value in words)
    meant = (find_near(shape, _SHAPES) or shape) + colon + rest
    return f"did you mean --path {meant}?" if meant != spec else ""


def make_design_car(settings: Settings) -> Car[float]:
    """The car that is designed for: with its effects on parameters, and the limiter's end stops."""
    car, limits = believed_car(settings.file.model), settings.limits
    return car._replace(
        steer_min=max(car.steer_min, -limits.steer_right_max),
        steer_max=min(car.steer_max, limits.steer_left_max),
    )


def plan_car(car: CarFile) -> RunPlan:
    """A plan at the file's own speed on a path that every such car can drive; its design too.

    Raises:
        SteerdError: it holds no car that can be driven, or one without a stable controller.
    """
    settings = make_settings(car)
    options = RunOptions(str(car.path), path="circle:radius=3", speed=settings.controller.speed)
    return make_plan(options, settings)


def report_refusal(car: CarFile) -> None:
    """Print a note where `steerd run` refuses the file, so that nobody learns it at the car."""
    try:
        plan_car(car)
    except SteerdError as error:
        text = f"`steerd run` refuses this file: {error.what}\n{error.hint}".rstrip()
        print_labelled("note: ", text, sys.stderr)


def make_world_config(plan: RunPlan, mocap_kind: str = "natnet") -> WorldConfig:
    """Simulated hardware for a plan: the simulated car, with the effects of the options.

    Raises:
        SteerdError: the simulated car's file or an effect is refused.
    """
    from steerd.sim_hw.mocap.cameras import MocapConfig
    from steerd.sim_hw.vesc.vesc_motor import VescConfig
    from steerd.sim_hw.world import WorldConfig

    settings, options = plan.sim, plan.options
    return WorldConfig(
        seed=options.seed,
        model=make_true_model(settings, options.effects),
        scaling=settings.scaling,
        vesc=VescConfig(current_limit=settings.brakes.current_max_a),
        mocap=MocapConfig(kind=mocap_kind, frame=settings.ingest.frame),
        keep_bytes=False,
    )
