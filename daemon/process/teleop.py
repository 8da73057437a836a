"""A gamepad as an operator and an external controller on the bus.

Nothing is sent while the deadman's button is not held, but a stop when it is released, until the
car shows it.
"""

# Why: docs/decisions/safety.md#d75

import secrets
import select
from collections.abc import Callable, Mapping
from dataclasses import replace

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process import gamepad
from steerd.daemon.process.bus_operator import KEEPALIVE_NS, BusOperator, CarView
from steerd.steer_bus import topics
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import BODY, DriveCommand, RequestKind, make_header

PERIOD_NS = 20_000_000  # time between two commands
VALID_MS = 200  # how long a command may be applied [ms]; less than the lease lasts


class Teleop:
    """One gamepad's operator and controller on the bus."""

    def __init__(
        self, view: CarView, pads: gamepad.PadMap, axes: Mapping[int, gamepad.AxisRange]
    ) -> None:
        self.pad = gamepad.PadState()
        self.view, self._pads, self._axes = view, pads, axes
        self._operator = BusOperator(view.bus, view.car, view.clock, "gamepad", view.pulse)
        self._lease = secrets.randbits(62) + 1
        self._seq = view.clock.realtime_ns() // 1_000_000 % 2_000_000_000
        self._alive_ns = 0

    def take(self, events: list[gamepad.PadEvent]) -> None:
        """Take in the gamepad's events."""
        for event in events:
            before = self.pad.held
            now = self.view.clock.now_ns()
            self.pad, pressed = gamepad.take_event(self.pad, event, self._pads, self._axes, now)
            if before and not self.pad.held:
                self.release()
            if pressed == self._pads.estop:
                self._operator.ask(self.view.boot_id, RequestKind.ESTOP)
            if pressed == self._pads.go and self.pad.held:
                self._go()

    def _go(self) -> None:
        """Arm a car that is ready, start one that is armed."""
        wanted = {SupervisorState.READY: RequestKind.ARM, SupervisorState.ARMED: RequestKind.START}
        kind = wanted.get(self.view.mode) if self.view.mode is not None else None
        if kind is not None:
            self._operator.ask(self.view.boot_id, kind)

    def release(self) -> None:
        """Stop the car, and be silent until the deadman's button is pressed again."""
        self.pad = replace(self.pad, held=False)
        self._operator.ask(self.view.boot_id, RequestKind.STOP)

    def step(self) -> str:
        """Every `PERIOD_NS`: hold the car and command it; gives what was released and why."""
        now = self.view.clock.now_ns()
        self._operator.repeat(self.view.mode)
        if gamepad.is_silent(self.pad, self._pads, now):
            self.release()
            return f"no event of the gamepad for {self._pads.quiet_ns * 1e-9:g} s: released"
        if not (self.pad.held and self.view.boot_id):
            return ""
        if now - self._alive_ns >= KEEPALIVE_NS:
            self._alive_ns = now
            self._operator.ask(self.view.boot_id, RequestKind.KEEPALIVE)
        bus = self.view.bus
        key = topics.make_key(self.view.car, topics.DRIVE, bus.who)
        bus.publish(key, encode(self._command(now)))
        return ""

    def _command(self, now_ns: int) -> DriveCommand:
        """The command of the axes; a car that is not driving stands straight."""
        self._seq += 1
        driving = self.view.mode is SupervisorState.RUNNING
        header = make_header(self.view.clock.realtime_ns(), BODY)
        return DriveCommand(
            header, self.view.boot_id, self._lease, now_ns, self._seq, VALID_MS,
            self.pad.steer * self._pads.steer_max if driving else 0.0,
            self.pad.speed * self._pads.speed_max if driving else 0.0,
        )  # fmt: skip


def serve_pad(teleop: Teleop, pad: gamepad.Pad, clock: Clock, say: Callable[[str], object]) -> None:
    """Serve until the gamepad is unplugged or its stream ends, which raises PadGoneError."""
    due = clock.now_ns()
    while True:
        ready, _, _ = select.select([pad.fd], [], [], max(due - clock.now_ns(), 0) * 1e-9)
        teleop.view.poll()
        if ready:
            teleop.take(pad.read())
        if clock.now_ns() >= due:
            due = clock.now_ns() + PERIOD_NS
            line = teleop.step()
            if line:
                say(line)
