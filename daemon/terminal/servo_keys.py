"""Moving a servo by keys, to find its centre and its stops. The motor is never commanded."""

import os
import select
import sys
from contextlib import closing
from dataclasses import dataclass, replace

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import raw
from steerd.daemon.terminal.key_desk import keys_one_by_one
from steerd.steer_bus.clock import Clock
from steerd.vesc_link import commands as c
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.packets import encode_command
from steerd.vesc_link.scaling import Scaling
from steerd.vesc_link.transport import PortError, open_port

HELP = """\
[a] [d] or arrows: move   [A] [D]: move far   [w]rite   [q]uit
set here: [c]entre   [l]eft stop   [r]ight stop"""
STEP, FAR = 0.005, 0.05  # servo positions per key press [-]; the whole range is 0 to 1
KEY_WAIT_S = 0.1
"""The position is sent again after this long without a key [s]; the VESC's timeout is longer."""
ESCAPE_NS = 20_000_000  # the three bytes of an arrow key arrive within this time [ns]
_MOVES = {"a": -STEP, "d": STEP, "A": -FAR, "D": FAR, "\x1b[D": -STEP, "\x1b[C": STEP}
_ENDS = ("w", "q", "\x03", "\x04")


@dataclass(frozen=True)
class Servo:
    """The servo's position (0 to 1) and the scaling set so far."""

    position: float
    scaling: Scaling


def press(servo: Servo, key: str) -> Servo:
    """Apply one key. Positive angles are left; `servo_gain` gives their direction.

    A ValueError where the limits would not be valid, e.g. one stop beyond the other.
    """
    if key in _MOVES:
        return replace(servo, position=min(max(servo.position + _MOVES[key], 0.0), 1.0))
    low, high = ("l", "r") if servo.scaling.servo_gain < 0.0 else ("r", "l")
    names = {"c": "servo_offset", low: "servo_min", high: "servo_max"}
    if key not in names:
        return servo
    at = round(servo.position, 4)
    return replace(servo, scaling=replace(servo.scaling, **{names[key]: at}))


def steer_by_keys(url: str, scaling: Scaling, clock: Clock) -> Scaling | None:
    """Move the servo by keys until [w] (returns the new scaling) or [q] (returns None).

    A SteerdError without a terminal, or where the port cannot be used.
    """
    servo = Servo(scaling.servo_offset, scaling)
    try:
        with closing(open_port(url)) as port, keys_one_by_one() as fd:
            if fd is None:
                hint = "run it in a terminal, or name a session instead of --port"
                raise UsageError("keys need a terminal", hint)
            print(HELP, file=sys.stderr)
            while True:
                port.write(encode_frame(encode_command(c.SetServoPos(servo.position))))
                s = servo.scaling
                line = f"\rposition {servo.position:.3f}   centre {s.servo_offset:.3f}   "
                line += f"low {s.servo_min:.3f}   high {s.servo_max:.3f} "
                print(line, end="", file=raw(sys.stderr), flush=True)
                key = _next_key(fd, clock)
                if key in _ENDS:
                    print(file=sys.stderr)  # what follows has a line of its own
                    return servo.scaling if key == "w" else None
                try:
                    servo = press(servo, key)
                except ValueError as error:
                    print(f"\n{error}", file=sys.stderr)
    except PortError as error:
        raise SteerdError(str(error), error.hint, ExitCode.UNREADABLE) from None


def _next_key(fd: int, clock: Clock) -> str:
    """The next key, an arrow's three bytes as one; empty after `KEY_WAIT_S` without a key."""
    if not select.select([fd], [], [], KEY_WAIT_S)[0]:
        return ""
    key = os.read(fd, 1).decode("latin-1")
    end = clock.now_ns() + ESCAPE_NS
    while key.startswith("\x1b") and len(key) < 3 and clock.now_ns() < end:
        if select.select([fd], [], [], 0.01)[0]:
            key += os.read(fd, 1).decode("latin-1")
    return key or "q"
