"""A design as a message, in both directions."""

import struct
from math import nan

from steerd.controller.gain_table import N_LANE, N_TURNING, GainTable
from steerd.controller.learnt import Design, Learnt
from steerd.steer_bus import messages as m

COLUMNS_MAX, ROWS_MAX = 120, 400
"""More past references and design speeds than any loop has."""
DESIGN_BYTES = 90_000
"""Longest message that is read, of the learner."""
_NOTHING = Learnt(*(nan,) * len(Learnt._fields))


def make_design(mono_ns: int, epoch_ns: int, number: int, design: Design) -> m.Design:
    """A design with its number, at a monotonic time."""
    rows = design.table.rows
    flat = [gain for row in rows for gain in row]
    return m.Design(
        m.make_header(mono_ns + epoch_ns, m.BODY), mono_ns, number, len(rows[0]), *design.car,
        design.table.speed_min, design.table.spacing, "", struct.pack(f"<{len(flat)}d", *flat),
    )  # fmt: skip


def make_no_design(mono_ns: int, epoch_ns: int, why: str) -> m.Design:
    """The car file's own design, and why."""
    header = m.make_header(mono_ns + epoch_ns, m.BODY)
    return m.Design(header, mono_ns, 0, 0, *_NOTHING, nan, nan, why, b"")


def read_design(message: m.Design) -> Design | None:
    """The design of a message; None for the car file's own, which has number 0.

    Raises:
        ValueError: its gains are no table.
    """
    if message.number == 0:
        return None
    columns, size = message.columns, len(message.gains)
    whole = N_LANE + N_TURNING <= columns <= COLUMNS_MAX and size and size % (8 * columns) == 0
    if not whole or size > 8 * columns * ROWS_MAX:
        raise ValueError(f"{size} bytes are no rows of {columns} gains")
    flat = struct.unpack(f"<{size // 8}d", message.gains)
    rows = tuple(flat[i : i + columns] for i in range(0, len(flat), columns))
    car = Learnt(*(getattr(message, name) for name in Learnt._fields))
    return Design(car, GainTable(message.speed_min, message.spacing, rows))
