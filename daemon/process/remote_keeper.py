"""The lane keeper of `steerd control`: estimates from the bus in, commands out."""

from math import isfinite

from steerd.car_model.state import State
from steerd.controller.lane_controller import (
    ControllerState,
    LaneController,
    control,
    start_controller,
)
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import topics
from steerd.steer_bus.bus import Bus
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import BODY, DriveCommand, StateMessage, make_header
from steerd.steer_bus.topics import make_key

VALID_MS = 100
"""How long a command may be applied [ms]."""
_POLL_NS = 1_000_000
"""Time between two looks at the bus [ns]."""


class RemoteKeeper:
    """The controller, fed with estimates of one topic, making commands for another."""

    def __init__(self, controller: LaneController, boot_id: int, lease_id: int) -> None:
        self._controller = controller
        self._boot_id = boot_id
        self._lease_id = lease_id
        self._state: ControllerState | None = None
        self._driving = False
        self._seq = 0

    def compute_command(self, message: StateMessage, realtime_ns: int) -> DriveCommand | None:
        """The command for one estimate; None while the estimate is not finite."""
        state = State(
            message.x,
            message.y,
            message.yaw,
            message.speed,
            message.yaw_rate,
            message.slip_angle,
            message.steer,
        )
        if not all(map(isfinite, state)):
            self._state = None
            return None
        driving = message.mode == SupervisorState.RUNNING
        if self._state is None or driving is not self._driving:
            self._state = start_controller(self._controller, state, message.mono_ns)
            self._driving = driving
        command, _, self._state = control(
            self._controller, self._state, state, message.mono_ns, stop=not driving
        )
        self._seq += 1
        return DriveCommand(
            make_header(realtime_ns, BODY),
            self._boot_id,
            self._lease_id,
            message.mono_ns,
            self._seq,
            VALID_MS,
            command.steer,
            command.speed,
        )


def serve(bus: Bus, car: str, keeper: RemoteKeeper, clock: Clock, end_ns: int | None) -> None:
    """Publish a command for every estimate until the time is over or a signal comes."""
    estimates = bus.subscribe(make_key(car, topics.STATE))
    key = make_key(car, topics.DRIVE, bus.who)
    while end_ns is None or clock.now_ns() < end_ns:
        for sample in estimates.poll():
            command = keeper.compute_command(decode(StateMessage, sample.data), clock.realtime_ns())
            if command is not None:
                bus.publish(key, encode(command))
        clock.sleep_until_ns(clock.now_ns() + _POLL_NS)
