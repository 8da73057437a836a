"""Faults of car, lane and filter: what the watchdogs of the driving itself (W6, W17 to W23) see."""

from dataclasses import replace
from math import cos, sin, tau
from typing import Any

from steerd.car_model.state import Command
from steerd.sim_hw.plant.car import Demand, Drive
from steerd.sim_hw.vesc.vesc_motor import Act, Mode
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


def surge(rig: Rig) -> None:
    """The motor turns twice as fast as commanded; its brake still works."""
    motor = rig.run.world.vesc.motor
    plain_command = motor.step

    def step(t_ns: int, h: float) -> Act:
        mode, value = plain_command(t_ns, h)
        return Act(mode, value * SURGE if mode is Mode.SPEED else value)

    motor.step = step  # type: ignore[method-assign]


def hit_a_wall(rig: Rig) -> None:
    """The wheels stand still against something while the motor pushes."""
    vesc = rig.run.world.vesc
    plain_command = vesc._act

    def act(demand: Act, erpm: float) -> tuple[Demand, float]:
        _, current = plain_command(demand, erpm)
        return WALL, WALL_CURRENT_A if demand[0] is Mode.SPEED else current

    vesc._act = act  # type: ignore[method-assign]


def fence_off(rig: Rig) -> None:
    """A fence all around the car; it is the car file's, not the world's."""
    loop = rig.run.core.loop
    state = rig.run.world.truth().state
    turns = [k * tau / 32 for k in range(32)]
    corners = tuple((state.x + FENCE_M * cos(a), state.y + FENCE_M * sin(a)) for a in turns)
    settings = loop.setup.settings
    thresholds = replace(settings.thresholds, fence=corners)
    loop.setup = replace(loop.setup, settings=replace(settings, thresholds=thresholds))


def diverge(rig: Rig) -> None:
    """The filter's uncertainty is beyond its bound."""
    perception = rig.run.core.loop.perception
    plain_command = perception.estimate

    def estimate(now_ns: int) -> Any:
        found = plain_command(now_ns)
        return found and replace(found, health=replace(found.health, position_sd=0.2))

    perception.estimate = estimate  # type: ignore[method-assign]


def stuck(steer: float) -> Any:
    """The controller wants one angle [rad] for ever; the car obeys."""

    def act(rig: Rig) -> None:
        loop = rig.run.core.loop
        plain_command = loop._make_wish

        def wish(*args: Any) -> Any:
            wanted, report = plain_command(*args)
            return wanted and Command(steer, wanted.speed), report

        loop._make_wish = wish  # type: ignore[method-assign]

    return act


def restart_quietly(rig: Rig) -> None:
    """The VESC has begun anew behind a port that stayed: its uptime goes back."""
    vesc = rig.run.world.vesc
    vesc.boot_ns = rig.t_ns
