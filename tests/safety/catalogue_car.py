"""Faults of car, lane and filter: what the watchdogs of the driving itself (W6, W17 to W23) see."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import cos, sin, tau
from typing import Any

from steerd.car_model.state import Command
from steerd.sim_hw.plant.car import COAST, Demand, Drive
from steerd.sim_hw.vesc.vesc_motor import Mode
from tests.safety.rig import Rig

WALL = Demand(Drive.BRAKE, 1000.0)
WALL_CURRENT_A = 45.0
SURGE = 2.0
FENCE_M = 1.3


def jam(angle: float) -> Any:
    """The road wheels stay at an angle [rad], whatever the servo command."""

    def act(rig: Rig) -> None:
        rig.run.world.vesc._servo = lambda _t_ns: angle  # type: ignore[method-assign]

    return act


def _motor(rig: Rig, act: Callable[..., tuple[Demand, float]]) -> None:
    """The motor does `act(plain, mode, value, erpm)`; `plain` is what it would do."""
    vesc = rig.run.world.vesc
    vesc._act = partial(act, vesc._act)  # type: ignore[method-assign]


def surge(rig: Rig) -> None:
    """The motor turns twice as fast as commanded; its brake still works."""
    _motor(rig, lambda plain, mode, value, erpm: plain(
        mode, value * SURGE if mode is Mode.SPEED else value, erpm
    ))  # fmt: skip


def hit_a_wall(rig: Rig) -> None:
    _motor(rig, lambda plain, mode, *more: (
        WALL, WALL_CURRENT_A if mode is Mode.SPEED else plain(mode, *more)[1]
    ))  # fmt: skip


def fence_off(rig: Rig) -> None:
    """A fence all around the car; it is the car file's, not the world's."""
    loop, state = rig.run.core.loop, rig.run.world.car.state
    turns = [k * tau / 32 for k in range(32)]
    corners = tuple((state.x + FENCE_M * cos(a), state.y + FENCE_M * sin(a)) for a in turns)
    settings = loop.plan.settings
    settings = replace(settings, thresholds=replace(settings.thresholds, fence=corners))
    loop.plan = replace(loop.plan, settings=settings)


def diverge(rig: Rig) -> None:
    """The filter's uncertainty is beyond its bound."""
    perception = rig.run.core.loop.perception
    plain_command = perception.estimate

    def estimate(now_ns: int) -> Any:
        found = plain_command(now_ns)
        return found and replace(found, health=replace(found.health, position_sd=0.2))

    perception.estimate = estimate  # type: ignore[method-assign]


def wish_for(rig: Rig, change: Callable[[Command[float] | None], Any]) -> None:
    """The controller wants what `change` makes of its wish, for ever; the car obeys."""
    loop = rig.run.core.loop
    plain = loop._make_wish

    def wish(*args: Any) -> Any:
        wanted, report = plain(*args)
        return change(wanted), report

    loop._make_wish = wish  # type: ignore[method-assign]


def stuck(steer: float) -> Any:
    return lambda rig: wish_for(rig, lambda wanted: wanted and Command(steer, wanted.speed))


def restart_quietly(rig: Rig) -> None:
    rig.run.world.vesc.boot_ns = rig.t_ns


RUNAWAY = 2.0  # acceleration of wheels that obey no speed [m/s^2]
SLOW_SERVO = 0.32  # a tenth of a servo's slew rate [rad/s]


def run_away(rig: Rig) -> None:
    """The wheels accelerate whatever speed is ordered; the brake still works."""
    push = Demand(Drive.FORCE, RUNAWAY + rig.run.world.car.setup.coast_decel)
    _motor(rig, lambda plain, mode, *more: (
        push if mode is Mode.SPEED else plain(mode, *more)[0], plain(mode, *more)[1]
    ))  # fmt: skip


def die(rig: Rig) -> None:
    _motor(rig, lambda *_: (COAST, 0.0))


def stick(rig: Rig) -> None:
    jam(rig.run.world.car.state.steer)(rig)


def reverse(rig: Rig) -> None:
    vesc = rig.run.world.vesc
    plain = vesc._servo
    vesc._servo = lambda t_ns: -plain(t_ns)  # type: ignore[method-assign]


def slow_down(rig: Rig) -> None:
    vesc = rig.run.world.vesc
    plain, at_ns, angle = vesc._servo, rig.t_ns, rig.run.world.car.state.steer

    def servo(t_ns: int) -> float:
        nonlocal at_ns, angle
        most = SLOW_SERVO * (t_ns - at_ns) * 1e-9
        angle += min(max(plain(t_ns) - angle, -most), most)
        at_ns = t_ns
        return angle

    vesc._servo = servo  # type: ignore[method-assign]
