"""Proposals of the learner: looked at piece by piece after the ticks, taken when all hold.

The check of a design takes tens of milliseconds, so one piece of it runs after each tick's bytes
were written. Whatever comes meanwhile is left alone; the learner proposes anew each second.
"""

# Why: docs/decisions/filter-and-controller.md#d85

import struct
from collections.abc import Iterator
from math import nan

from steerd.controller.acceptance import check_design
from steerd.controller.gain_table import N_LANE, N_TURNING, GainTable
from steerd.controller.learnt import Design, Learnt
from steerd.daemon.loop.adapting import Adapting
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import CodecError, decode

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


OLD_NS = 3_000_000_000
"""A proposal about a pose this much older, or younger, than now is left alone."""
REFUSED = "refused: "
"""What a text begins with that says why a proposal was not taken."""


class DesignDesk:
    """Proposals in, messages to be taken out; knows no clock.

    Attributes:
        taken: the design that was taken last, or None.
        refused: how many were refused.
    """

    def __init__(self) -> None:
        self.taken: Design | None = None
        self.refused = 0
        self._number = 0
        self._checking: Iterator[str] | None = None
        self._design: Design | None = None
        self._against: Learnt | None = None
        self._answer: str | None = None
        self._renew = False
        self._followed = False

    def offer(self, now: Adapting, data: bytes, t_ns: int) -> None:
        """A proposal arrived; what is no message or out of time is left alone."""
        if now.held is None or self._checking is not None or len(data) > DESIGN_BYTES:
            return
        try:
            message = decode(m.Design, data)
        except CodecError:
            return
        if abs(t_ns - message.mono_ns) > OLD_NS:
            return
        try:
            design = read_design(message)
        except ValueError as error:
            self._refuse(str(error))
            return
        if design is None:
            self._answer = message.text
        elif now.follows and design == self.taken:
            self._renew = True
        else:
            self._design, self._against = design, now.car
            self._checking = check_design(now.held, now.car or design.car, design)

    def _refuse(self, why: str) -> None:
        self.refused += 1
        self._answer = REFUSED + why

    def step(self, now: Adapting, t_ns: int, epoch_ns: int) -> m.Design | None:
        """One piece of the check; what the loop is to take, if there is something."""
        fell, self._followed = self._followed and not now.follows, now.follows
        if fell:
            self._checking = self.taken = None
            return make_no_design(t_ns, epoch_ns, now.why)
        if self._checking is not None:
            self._check(now)
        if self._answer is not None:
            why, self._answer, self.taken = self._answer, None, None
            return make_no_design(t_ns, epoch_ns, why)
        if self._renew and self.taken is not None:
            self._renew = False
            return make_design(t_ns, epoch_ns, self._number, self.taken)
        return None

    def _check(self, now: Adapting) -> None:
        try:
            problem = next(self._checking, None) if self._checking is not None else ""
        except (ValueError, ArithmeticError) as error:  # numbers that no loop has
            problem = f"it cannot be computed: {error}"
        if problem:
            self._checking = None
            self._refuse(problem)
        elif problem is None:
            self._checking = None
            if now.car == self._against:  # else another is in force than it was held against
                self.taken, self._renew = self._design, True
                self._number += 1
