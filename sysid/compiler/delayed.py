"""Delayed commands for a block of windows, and the adjoint of the delay.

Appended, before `loops`, to the pieces printed for a model. A dead time need not be a whole number
of steps: the mean of a held signal over a step is linear in its delay
(`car_model.rollout.channel_delayed`).
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.arguments import Block, CommandStream, Integration
from steerd.sysid.compiler.compile import allocating, entry_point, inlined, not_inlined
from steerd.sysid.compiler.simd_rows import add_row, gather_row, mix_row

if TYPE_CHECKING:
    from steerd.sysid.compiler.pieces import DELAYS_SLOPES, SLOTS, Array, delays_jac


@allocating
def delay_slopes(p: "Array", q: "Array", h: float) -> "Array":
    """Dead times of steer, drive and pose [s], then their nonzero derivatives (`DELAYS_BY`)."""
    w = np.zeros(3 + DELAYS_SLOPES)
    delays_jac(w, p, q, h)
    return w


@entry_point
def delays_at(p: "Array", q: "Array", h: float) -> "Array":
    """`delay_slopes`, for Python."""
    found: Array = delay_slopes(p, q, h)
    return found


@allocating
def delays_in_steps(m: Integration) -> "Array":
    """Dead times of steer, drive and pose in steps."""
    steps: Array = delay_slopes(m.p, m.q, m.h)[:3] / m.h
    return steps


@inlined
def unsigned(place: int) -> int:
    """A place in an array, as a number that cannot be negative.

    For other numbers Numba tests whether they count from the end, and LLVM does not vectorise.
    """
    return np.uint64(place)  # type: ignore[return-value]


@allocating
def make_stream(m: Integration, block: Block, steps: int) -> CommandStream:
    """The commands that take effect in a block's windows.

    The first entry is the oldest command that still arrives within the windows. Before a run's
    first command the first holds, after the last the last.
    """
    delay_steps = delays_in_steps(m)
    oldest = int(np.floor(max(delay_steps[0], delay_steps[1]))) + m.substeps
    newest = steps - int(np.floor(min(delay_steps[0], delay_steps[1])))
    ahead = -(-oldest // m.substeps)
    length = ahead + newest // m.substeps + 1
    rows = np.empty(2 * length * SLOTS)
    for slot in range(SLOTS):
        low, high, start = block.runs[slot, 0], block.runs[slot, 1], block.runs[slot, 2]
        for c in range(length):
            row, at = unsigned(min(max(start + c - ahead, low), high - 1)), c * SLOTS + slot
            rows[unsigned(at)] = block.commands[row, 0]
            rows[unsigned(at + length * SLOTS)] = block.commands[row, 1]
    return CommandStream(rows, ahead, delay_steps, m.substeps)


@not_inlined
def add_stream_gradient(bars: "Array", block: Block, into: "Array", ahead: int) -> None:
    """The adjoint of `make_stream`: from rows of the stream to rows of the commands."""
    length = len(bars) // (2 * SLOTS)
    for slot in range(SLOTS):
        low, high, start = block.runs[slot, 0], block.runs[slot, 1], block.runs[slot, 2]
        for c in range(length):
            row, at = unsigned(min(max(start + c - ahead, low), high - 1)), c * SLOTS + slot
            into[row, 0] += bars[unsigned(at)]
            into[row, 1] += bars[unsigned(at + length * SLOTS)]


@inlined
def delay_commands(w: "Array", row: int, stream: CommandStream, k: int) -> None:
    """Write both delayed commands of integration step `k` as rows."""
    length = len(stream.rows) // (2 * SLOTS)
    for channel in range(2):
        delay, first = stream.delay_steps[channel], channel * length + stream.ahead
        whole = int(np.floor(delay))
        part = delay - whole
        newer = (first + (k - whole) // stream.substeps) * SLOTS
        older = (first + (k - whole - 1) // stream.substeps) * SLOTS
        to = (row + channel) * SLOTS
        mix_row(w, to, stream.rows, newer, stream.rows, older, 1.0 - part, part)


@inlined
def add_delay_gradient(
    w: "Array", row: int, stream: CommandStream, k: int, delay_bars: "Array"
) -> None:
    """The adjoint of `delay_commands` by the delays in steps."""
    length = len(stream.rows) // (2 * SLOTS)
    for channel in range(2):
        whole = int(np.floor(stream.delay_steps[channel]))
        first = channel * length + stream.ahead
        newer = (first + (k - whole) // stream.substeps) * SLOTS
        older = (first + (k - whole - 1) // stream.substeps) * SLOTS
        at, to = (row + channel) * SLOTS, channel * SLOTS
        gather_row(delay_bars, to, w, at, stream.rows, older, 1.0)
        gather_row(delay_bars, to, w, at, stream.rows, newer, -1.0)


@inlined
def add_command_gradient(
    w: "Array", row: int, bars: "Array", stream: CommandStream, k: int
) -> None:
    """The adjoint of `delay_commands` by the commands, into rows like the stream's."""
    length = len(bars) // (2 * SLOTS)
    for channel in range(2):
        delay, first = stream.delay_steps[channel], channel * length + stream.ahead
        whole = int(np.floor(delay))
        part, at = delay - whole, (row + channel) * SLOTS
        add_row(bars, (first + (k - whole) // stream.substeps) * SLOTS, w, at, 1.0 - part)
        add_row(bars, (first + (k - whole - 1) // stream.substeps) * SLOTS, w, at, part)
