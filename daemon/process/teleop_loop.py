"""The loop of `steerd teleop`: the gamepad's events as they come, a command every 20 ms."""

import select
from collections.abc import Callable

from steerd.daemon.process.gamepad import Pad
from steerd.daemon.process.teleop import PERIOD_NS, Teleop
from steerd.steer_bus.clock import Clock


def serve_pad(teleop: Teleop, pad: Pad, clock: Clock, say: Callable[[str], object]) -> None:
    """Serve until the gamepad is gone.

    Raises:
        PadGoneError: it was unplugged, or its stream has ended.
    """
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
