"""One drive of a sweep, in a worker: the whole closed loop in virtual time, to a row of numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from steerd.car_model.effects import find_effect
from steerd.car_model.model import believed_car
from steerd.car_model.params import PARAMETERS
from steerd.car_model.path.path import locate, project
from steerd.controller.design import assess, delay_margin
from steerd.controller.loop_model import Timing
from steerd.daemon.assembly.build import NS, RunPlan, make_plan, make_world_config
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.many.sweep.plan import DRIVEN, REFUSED, STOPPED, DriveCase, SweepPlan
from steerd.daemon.offline.virtual import VirtualRun, drive, make_virtual_run
from steerd.daemon.sessions.motion import SETTLE, rms
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.world import World, WorldConfig


def run_case(plan: SweepPlan, case: DriveCase) -> dict[str, Any]:
    """Drive one case; its end and its measures, by column."""
    try:
        run_plan, config = prepare(plan, case)
        _ = run_plan.controller
    except SteerdError as error:
        return {"outcome": REFUSED, "watchdog": "", "reason": error.what}
    run = make_virtual_run(run_plan, (), World(config))
    seen = Seen(run_plan)
    drive(run, seen.take)
    return _judge_end(run) | seen.judge() | _judge_loop(run_plan, config)


def prepare(plan: SweepPlan, case: DriveCase) -> tuple[RunPlan, WorldConfig]:
    """The drive's plan, and its simulated hardware.

    Raises:
        SteerdError: a path or a value cannot be used.
    """
    values = case.values
    speed = float(values.get("speed", plan.speed))
    options = RunOptions(
        car_file="", path=str(values.get("path", plan.path)), speed=speed, rate_hz=plan.rate,
        duration_s=plan.duration, seed=case.seed, simulated=True, auto_arm=True,
        effects=_format_effects(values),
    )  # fmt: skip
    settings = make_settings(plan.car, speed)
    names = [p.name for p in PARAMETERS if f"car.{p.name}" in values]
    drawn = {name: float(values[f"car.{name}"]) for name in names}
    car = replace(settings.file, car=settings.file.car._replace(**drawn))
    run_plan = replace(make_plan(options, settings), drawn=replace(settings, file=car))
    return run_plan, _vary_instruments(make_world_config(run_plan), values)


def _format_effects(values: Mapping[str, float | str]) -> tuple[str, ...]:
    """Effects as `--effect` takes them, the parameters of one together."""
    found: dict[str, list[str]] = {}
    for name, value in values.items():
        kind, _, rest = name.partition(".")
        if kind == "effect":
            effect, _, parameter = rest.partition(".")
            parameter = parameter or find_effect(effect).parameters[0].name
            found.setdefault(effect, []).append(f"{parameter}={value!r}")
    return tuple(f"{effect}:{','.join(texts)}" for effect, texts in found.items())


def _vary_instruments(config: WorldConfig, values: Mapping[str, float | str]) -> WorldConfig:
    """The simulated hardware with the drawn noise and delays."""
    given = {name: float(v) for name, v in values.items() if not isinstance(v, str)}

    def pick(device: str, *names: str) -> dict[str, Any]:
        return {name: given[f"{device}.{name}"] for name in names if f"{device}.{name}" in given}

    mocap = pick("mocap", "position_noise", "yaw_noise")
    vesc = pick("vesc", "erpm_noise", "gyro_noise")
    if "mocap.latency" in given:
        later = round(given["mocap.latency"] * NS) - config.mocap.software_ns
        mocap |= {"camera_ns": max(later, 0)}
    if "mocap.jitter" in given:
        mocap |= {"jitter_ns": round(given["mocap.jitter"] * NS)}
    if "vesc.reply_delay" in given:
        vesc |= {"reply_delay_ns": round(given["vesc.reply_delay"] * NS)}
    return replace(config, mocap=replace(config.mocap, **mocap), vesc=replace(config.vesc, **vesc))


@dataclass
class Seen:
    """What a drive shows tick by tick, once it has settled on its lane."""

    plan: RunPlan  # of the drive
    e1: list[float] = field(default_factory=list)  # lateral error as estimated
    e2: list[float] = field(default_factory=list)  # heading error as estimated
    true_e1: list[float] = field(default_factory=list)  # lateral error of the simulated car
    steer: list[float] = field(default_factory=list)  # share of the wheel angle used
    began_ns: int | None = None  # when the car began to drive; None before
    seconds: float = 0.0  # driven, the approach with it
    metres: float = 0.0  # the same
    _hint: int = 0

    def take(self, run: VirtualRun) -> None:
        """A tick has passed."""
        result = run.core.last
        if result is None or result.supervisor.state is not SupervisorState.RUNNING:
            return
        if self.began_ns is None:
            self.began_ns = run.t_ns
        state, report = run.world.car.state, result.report
        self.seconds += run.period_ns / NS
        self.metres += abs(state.speed) * run.period_ns / NS
        if report is None or run.t_ns - self.began_ns < SETTLE * NS:
            return
        if not self.true_e1:
            self._hint = locate(self.plan.path, state.x, state.y, state.yaw).hint
        place = project(self.plan.path, state.x, state.y, self._hint)
        self._hint = place.hint
        limits = self.plan.settings.limits
        most = limits.steer_left_max if report.wheel > 0.0 else limits.steer_right_max
        self.e1.append(abs(report.e1))
        self.e2.append(abs(report.e2))
        self.true_e1.append(abs(place.e1))
        self.steer.append(abs(report.wheel) / most)

    def judge(self) -> dict[str, Any]:
        """The measures of `summary.MEASURES` that a drive itself gives."""
        row: dict[str, Any] = {"seconds": self.seconds, "metres": self.metres}
        if not self.e1:
            return row
        e1, true_e1 = np.array(self.e1), np.array(self.true_e1)
        return row | {
            "e1_rms": rms(e1),
            "e1_p95": float(np.quantile(e1, 0.95)),
            "e1_max": float(e1.max()),
            "true_e1_rms": rms(true_e1),
            "true_e1_max": float(true_e1.max()),
            "e2_rms": rms(np.array(self.e2)),
            "lane_margin": self.plan.settings.thresholds.lateral - float(e1.max()),
            "steer_margin": 1.0 - max(self.steer),
        }


def _judge_end(run: VirtualRun) -> dict[str, Any]:
    """Whether it was driven to its end, and what stopped it."""
    loop = run.core.loop
    if not loop.faulted and loop.ran:
        return {"outcome": DRIVEN, "watchdog": "", "reason": ""}
    waiting = run.core.last.waiting if run.core.last else ""
    reason = loop.fault or f"never driven: waiting for {waiting}"
    return {
        "outcome": STOPPED,
        "watchdog": reason.split()[0] if loop.faulted else "",
        "reason": reason,
    }


def _judge_loop(plan: RunPlan, config: WorldConfig) -> dict[str, Any]:
    """How stable the designed gains hold the car that was drawn."""
    car, table = believed_car(config.model), plan.controller.table
    timing = Timing(plan.options.rate_hz, car.steer_delay + car.pose_delay, car.steer_lag)
    return {
        "damping": min(at.damping for at in assess(car, table, timing)),
        "delay_margin": delay_margin(car, table, timing),
    }
