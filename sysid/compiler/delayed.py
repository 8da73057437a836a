"""Commands as they arrive: late, and for a block of windows side by side.

Appended, before `loops`, to the pieces printed for a model.
"""

# ruff: noqa: TC004  (the printed pieces stand above this text in the compiled module)
from typing import TYPE_CHECKING

import numpy as np

from steerd.sysid.compiler.compile import apart, entry, maker, point
from steerd.sysid.compiler.simd_rows import add_row, gather_row, mix_row

if TYPE_CHECKING:
    from steerd.sysid.compiler.pieces import DELAYS_SLOPES, LANES, Array, delays_jac


@entry
def delays_at(p: "Array", q: "Array", h: float) -> "Array":
    """Dead times of steer, drive and pose [s]."""
    out, j = np.zeros(3), np.zeros(max(DELAYS_SLOPES, 1))
    delays_jac(out, p, q, h, out, j)
    return out


@maker
def delays_in_steps(p: "Array", q: "Array", h: float) -> "Array":
    """Dead times of steer, drive and pose in steps."""
    late, j = np.zeros(3), np.zeros(max(DELAYS_SLOPES, 1))
    delays_jac(late, p, q, h, late, j)
    for i in range(3):
        late[i] /= h
    return late


@point
def spot(place: int) -> int:
    """A place in an array, as a number that cannot be negative.

    Numba would test every other one for counting from the end, and LLVM not vectorise.
    """
    return np.uint64(place)  # type: ignore[return-value]


@point
def stream_ahead(late: "Array", substeps: int) -> int:
    """How many entries of a stream lie before the windows' first step."""
    oldest: int = int(np.floor(max(late[0], late[1]))) + substeps
    return -(-oldest // substeps)


@point
def stream_length(late: "Array", steps: int, substeps: int) -> int:
    """How many entries a stream has."""
    newest = steps - int(np.floor(min(late[0], late[1])))
    length: int = stream_ahead(late, substeps) + newest // substeps + 1
    return length


@maker
def make_stream(
    commands: "Array", runs: "Array", late: "Array", steps: int, substeps: int
) -> "Array":
    """Commands of a block as rows of lanes: all of steer, then all of speed.

    The first entry is the oldest command that still arrives late in the windows; before a run's
    first command the first holds, after the last the last.
    """
    ahead, length = stream_ahead(late, substeps), stream_length(late, steps, substeps)
    stream = np.empty(2 * length * LANES)
    for lane in range(LANES):
        low, high, start = runs[lane, 0], runs[lane, 1], runs[lane, 2]
        for c in range(length):
            row, at = spot(min(max(start + c - ahead, low), high - 1)), c * LANES + lane
            stream[spot(at)] = commands[row, 0]
            stream[spot(at + length * LANES)] = commands[row, 1]
    return stream


@apart
def return_stream(bars: "Array", runs: "Array", into: "Array", ahead: int) -> None:
    """The reverse of `make_stream`."""
    length = len(bars) // (2 * LANES)
    for lane in range(LANES):
        low, high, start = runs[lane, 0], runs[lane, 1], runs[lane, 2]
        for c in range(length):
            row, at = spot(min(max(start + c - ahead, low), high - 1)), c * LANES + lane
            into[row, 0] += bars[spot(at)]
            into[row, 1] += bars[spot(at + length * LANES)]


@point
def fetch_commands(
    w: "Array", row: int, stream: "Array", ahead: int, k: int, substeps: int, late: "Array"
) -> None:
    """Write both delayed commands of fine step `k` as rows.

    The mean of a held signal over a step is linear in its delay (`rollout.channel_delayed`).
    """
    length = len(stream) // (2 * LANES)
    for channel in range(2):
        whole, first = int(np.floor(late[channel])), channel * length + ahead
        part = late[channel] - whole
        newer = (first + (k - whole) // substeps) * LANES
        older = (first + (k - whole - 1) // substeps) * LANES
        mix_row(w, (row + channel) * LANES, stream, newer, stream, older, 1.0 - part, part)


@point
def gather_lateness(
    w: "Array",
    row: int,
    stream: "Array",
    ahead: int,
    k: int,
    substeps: int,
    late: "Array",
    late_bars: "Array",
) -> None:
    """The reverse of `fetch_commands`: derivatives to the delays in steps."""
    length = len(stream) // (2 * LANES)
    for channel in range(2):
        whole, first = int(np.floor(late[channel])), channel * length + ahead
        newer = (first + (k - whole) // substeps) * LANES
        older = (first + (k - whole - 1) // substeps) * LANES
        at, to = (row + channel) * LANES, channel * LANES
        gather_row(late_bars, to, w, at, stream, older, 1.0)
        gather_row(late_bars, to, w, at, stream, newer, -1.0)


@point
def return_commands(
    w: "Array", row: int, bars: "Array", ahead: int, k: int, substeps: int, late: "Array"
) -> None:
    """The reverse of `fetch_commands`: derivatives to the commands."""
    length = len(bars) // (2 * LANES)
    for channel in range(2):
        whole, first = int(np.floor(late[channel])), channel * length + ahead
        part, at = late[channel] - whole, (row + channel) * LANES
        add_row(bars, (first + (k - whole) // substeps) * LANES, w, at, 1.0 - part)
        add_row(bars, (first + (k - whole - 1) // substeps) * LANES, w, at, part)
