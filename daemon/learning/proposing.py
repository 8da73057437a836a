"""The learner's proposals: each second a design one step closer to the learnt car, or none.

It hears from the core what was taken, and steps on from there.
"""

from collections.abc import Callable

from steerd.controller.acceptance import Acceptance
from steerd.controller.build import DesignTable
from steerd.controller.design import DesignRefused
from steerd.controller.learnt import (
    Design,
    Learnt,
    approach_learnt,
    learnt_car,
    learnt_of,
    learnt_timing,
)
from steerd.daemon.loop.adapting import REFUSED, make_design, make_no_design, read_design
from steerd.sim_gap.online.learner import Learner, State
from steerd.sim_gap.online.values import find_aim
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode

STILL = 0.1
"""A step smaller than this share of the largest is none: the design stays."""
PAUSE_NS = 15_000_000_000
"""After a refusal nothing is proposed for so long."""


class Proposals:
    """Proposes from the file's design on.

    Args:
        held: what the core holds designs against.
        design_table: computes gains, see `steerd.controller.gains`.
        send: takes each proposal as bytes, and when it was made [ns].
    """

    def __init__(
        self, held: Acceptance, design_table: DesignTable, send: Callable[[bytes, int], object]
    ) -> None:
        self._held, self._design_table, self._send = held, design_table, send
        self._file = learnt_of(held.file.car)
        self._at = self._file  # the numbers in force, as the core said
        self._design: Design | None = None  # the last proposal
        self._refused_ns = -PAUSE_NS  # when the core refused one last

    def hear(self, taken: m.Design) -> None:
        """The core took a design, or the file's."""
        design = read_design(taken)
        if design is not None:
            self._at = design.car
            return
        self._at, self._design = self._file, None
        if taken.text.startswith(REFUSED):
            self._refused_ns = taken.mono_ns

    def propose(self, learner: Learner, state: State, mono_ns: int, epoch_ns: int) -> None:
        """Propose at a report of a state; times of the newest pose, UNIX minus monotonic [ns]."""
        design = self._next_design(find_aim(learner, state), mono_ns)
        self._design = None if isinstance(design, str) else design
        if not isinstance(design, str) and design.car == self._file:
            design = "the car is as in the car file"
        proposal = (
            make_no_design(mono_ns, epoch_ns, design)
            if isinstance(design, str)
            else make_design(mono_ns, epoch_ns, 1, design)
        )
        self._send(encode(proposal), mono_ns)

    def _next_design(self, aim: Learnt | str, mono_ns: int) -> Design | str:
        """One step towards an aim; why there is none."""
        if isinstance(aim, str):
            return aim
        if mono_ns - self._refused_ns < PAUSE_NS:
            return "a design was refused"
        file, steps = self._held.file, self._held.steps
        car = approach_learnt(self._at, aim, self._held.bounds, steps)
        if self._design is not None and all(
            abs(a - b) <= STILL * most
            for a, b, most in zip(car, self._design.car, steps, strict=True)
        ):
            return self._design
        own, timing = learnt_car(file, car), learnt_timing(file, car)
        try:
            return Design(car, self._design_table(own, file.config, timing, file.profile.fastest))
        except DesignRefused as error:
            return str(error)
