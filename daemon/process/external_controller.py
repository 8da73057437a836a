"""Anybody's controller on the bus: estimates in, commands out.

The lane keeper of `steerd control` is one, and so is a function of a user's own (`steerd.serve`,
`steerd.simulate(controller=...)`). The daemon's limits, lease and watchdogs hold for all of them.
"""

import secrets
from collections.abc import Callable
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from steerd.car_model.state import State
from steerd.controller import lane_controller as lanes
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.loop.lease import VALID_MS
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import BODY, DriveCommand, StateMessage, make_header

if TYPE_CHECKING:
    from steerd.daemon.process.bus_operator import CarView

_POLL_NS = 1_000_000  # time between two looks at the bus [ns]
_PAUSE = 0.1  # a lane keeper without estimates for longer searches its lane anew [s]


class Lane(NamedTuple):
    """Where the car is in its lane."""

    e1: float  # lateral offset, left positive [m]
    e2: float  # heading error [rad]
    curvature: float  # of the lane here, left positive [1/m]
    s: float  # arc length along the lane [m]
    speed: float  # that the daemon's own lane keeper would drive [m/s]
    # Whether the car drives, or is coming to its stop; otherwise commands only show that the
    # controller is there
    driving: bool
    stopping: bool


Controller = Callable[[float, State[float], Lane], tuple[float, float]]
"""From time [s], estimate and lane to the command (steer [rad], speed [m/s])."""


class ExternalController:
    """A controller, fed with estimates of one topic, making commands for another."""

    def __init__(self, controller: Controller, boot_id: int, lease_id: int) -> None:
        self._controller = controller
        self._boot_id = boot_id
        self._lease_id = lease_id
        self._seq = 0

    def compute_command(self, message: StateMessage, realtime_ns: int) -> DriveCommand | None:
        """The command for one estimate; None while the estimate is not finite.

        Raises:
            SteerdError: the controller does not return two finite numbers.
        """
        m = message
        state = State(m.x, m.y, m.yaw, m.speed, m.yaw_rate, m.slip_angle, m.steer)
        if not all(map(isfinite, state)):
            return None
        driving, stopping = (
            m.mode == each for each in (SupervisorState.RUNNING, SupervisorState.STOPPING)
        )
        lane = Lane(m.e1, m.e2, m.curvature, m.path_s, m.speed_ref, driving, stopping)
        steer, speed = _checked(self._controller(m.mono_ns * 1e-9, state, lane))
        self._seq += 1
        header = make_header(realtime_ns, BODY)
        return DriveCommand(
            header, self._boot_id, self._lease_id, m.mono_ns, self._seq, VALID_MS, steer, speed
        )


def _checked(command: object) -> tuple[float, float]:
    try:
        steer, speed = (float(value) for value in command)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        steer = speed = float("nan")
    if not (isfinite(steer) and isfinite(speed)):
        hint = "return (steer [rad], speed [m/s])"
        raise SteerdError(f"the controller returned {command!r}, not two finite numbers", hint)
    return steer, speed


def while_driving(controller: Controller) -> Controller:
    """A controller that is asked only while the car drives; to a stop it steers, no faster."""

    def command(t: float, state: State[float], lane: Lane) -> tuple[float, float]:
        if not (lane.driving or lane.stopping):
            return 0.0, 0.0
        steer, speed = _checked(controller(t, state, lane))
        return steer, min(speed, lane.speed) if lane.stopping else speed

    return command


def keep_lane(controller: lanes.LaneController) -> Controller:
    """The daemon's own lane keeper."""
    kept: lanes.ControllerState | None = None
    before = False

    def command(t: float, state: State[float], lane: Lane) -> tuple[float, float]:
        nonlocal kept, before
        t_ns = round(t * 1e9)
        if kept is None or lane.driving is not before or t_ns - kept.t_ns > _PAUSE * 1e9:
            kept, before = lanes.start_controller(controller, state, t_ns), lane.driving
        order, _, kept = lanes.control(controller, kept, state, t_ns, stop=not lane.driving)
        return order.steer, order.speed

    return command


def answer(view: "CarView", controller: Controller, duration: float | None) -> None:
    """Publish a command for every estimate, for so long [s] or until a signal comes."""
    bus, clock = view.bus, view.clock
    made = ExternalController(controller, view.boot_id, secrets.randbits(62) + 1)
    end_ns = inf if duration is None else clock.now_ns() + round(duration * 1e9)
    estimates = bus.subscribe(topics.make_key(view.car, topics.STATE))
    key = topics.make_key(view.car, topics.DRIVE, bus.who)
    while clock.now_ns() < end_ns:
        for sample in estimates.poll():
            command = made.compute_command(decode(StateMessage, sample.data), clock.realtime_ns())
            if command is not None:
                bus.publish(key, encode(command))
        clock.sleep_until_ns(clock.now_ns() + _POLL_NS)


def serve(
    controller: Controller,
    car: str = "car1",
    *,
    connect: str | None = None,
    lab: Path | str | None = None,
    duration: float | None = None,
) -> None:
    """Steer a car of `steerd run --controller zenoh` with a function of one's own.

    The car's limits, lease and watchdogs hold as for any controller: where commands stop coming,
    the car stops.

    Args:
        controller: from time [s], `State` and `Lane` to (steer [rad], speed [m/s]); called with
            every estimate while the car drives.
        car: its name.
        connect: zenoh endpoint of the run; None for the lab's or this machine's.
        lab: our folder of `steerd keys`; None without.
        duration: ends after so long [s]; None until interrupted.

    Raises:
        SteerdError: no run answers, or the controller returns no command.
    """
    from steerd.daemon.process import bus_operator  # zenoh, where nothing is served

    folder = None if lab is None else Path(lab)
    with bus_operator.connect(connect, folder, "steerd run --controller zenoh") as bus:
        view = bus_operator.CarView(bus, car, MonotonicClock()).wait_heard()
        answer(view, while_driving(controller), duration)
