"""A tick of a loop that has raised (W29): supervisor and brake only.

Filter, controller and watchdogs do not run, because one of them has just raised. The servo gets no
new angle, so it holds the last one.
"""

# Why: docs/decisions/safety.md#d42

import traceback
from dataclasses import replace
from typing import TYPE_CHECKING

from steerd.car_model.state import Command
from steerd.controller.limits import make_limiter_state
from steerd.daemon.loop.findings import make_finding, summarise
from steerd.daemon.loop.orders import TickResult, make_order
from steerd.daemon.loop.supervisor import Conditions, step_supervisor
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.settings.config import BrakeSettings
from steerd.steer_bus.messages import ActuationMode
from steerd.vesc_link.vesc import Drive

if TYPE_CHECKING:
    from steerd.daemon.loop.loop import Loop

_DRIVING = (SupervisorState.RUNNING, SupervisorState.STOPPING)


def describe_error(error: BaseException) -> str:
    """Type, place and text of an exception on one line."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" at {frames[-1].name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}{place}: {error}"


def make_failed_tick(loop: "Loop", error: BaseException, now_ns: int, linked: bool) -> TickResult:
    """Decide a tick without the part that failed: an armed car brakes and latches."""
    finding = make_finding("W29", describe_error(error))
    bits, text = summarise((finding,))
    facts = bits | Fact.IDENTIFIED | Fact.SLOWING | (Fact.LINKED if linked else 0)
    settings, speed = loop.setup.settings, loop.perception.recent_wheel_speed(now_ns)
    old = loop.supervisor.state
    conditions = Conditions(facts, speed, 0, text)
    loop.supervisor, action = step_supervisor(loop.supervisor, conditions, 0, now_ns)
    if loop.supervisor.state is SupervisorState.FAULT_STOP:
        loop.fault = loop.supervisor.reason
    loop.ran = loop.ran or (old in _DRIVING and loop.supervisor.state not in _DRIVING)
    limiter = make_limiter_state(settings.limits, Command(0.0, 0.0), now_ns)
    order = make_order(settings, limiter, action, None, speed, now_ns)
    return TickResult(
        replace(order, drive=_remove_steering(order.drive, settings.brakes)),
        action,
        old,
        loop.supervisor,
        None,
        None,
        (finding,),
        action.waiting,
        facts,
    )


def _remove_steering(drive: Drive, brakes: BrakeSettings) -> Drive:
    if drive.mode is ActuationMode.SPEED:
        return Drive(ActuationMode.BRAKE, current=brakes.brake_current_a)
    return replace(drive, steer=None)
