"""The learner's proposals: each second a design one step closer to the learnt car, or none.

It hears from the core what was taken, and steps on from there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from steerd.controller.acceptance import Acceptance, file_numbers
from steerd.controller.build import DesignTable
from steerd.controller.design import DesignRefused
from steerd.controller.learnt import Design, Learnt, approach_learnt, learnt_car, learnt_timing
from steerd.daemon.loop.design_desk import REFUSED, make_design, make_no_design, read_design
from steerd.sim_gap.online.learner import Learner, State
from steerd.sim_gap.online.values import find_aim
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode

STILL = 0.1
"""A step smaller than this share of the largest is none: the design stays."""
PAUSE_NS = 15_000_000_000
"""After a refusal nothing is proposed for so long."""


@dataclass(frozen=True, eq=False)
class Proposer:
    """What is proposed next."""

    held: Acceptance  # what the core holds designs against
    design_table: DesignTable  # computes gains, see `steerd.controller.gains`
    at: Learnt  # the numbers in force, as the core said
    design: Design | None = None  # the last proposal; None before the first
    refused_ns: int = -PAUSE_NS  # when the core refused one last


def make_proposer(held: Acceptance | None, design_table: DesignTable) -> Proposer:
    """At the start: the file's design is in force.

    Raises:
        ValueError: nothing is followed in this run.
    """
    if held is None:
        raise ValueError("a run without --adapt follows nothing")
    return Proposer(held, design_table, file_numbers(held))


def hear(proposer: Proposer, taken: m.Design) -> Proposer:
    """What the core took."""
    design = read_design(taken)
    if design is not None:
        return replace(proposer, at=design.car)
    refused = taken.mono_ns if taken.text.startswith(REFUSED) else proposer.refused_ns
    at = file_numbers(proposer.held)
    return replace(proposer, at=at, design=None, refused_ns=refused)


def propose(
    proposer: Proposer, learner: Learner, state: State, mono_ns: int, epoch_ns: int
) -> tuple[Proposer, m.Design]:
    """The proposal at a report.

    Args:
        proposer: so far.
        learner: the car's.
        state: what was learnt.
        mono_ns: of the newest pose.
        epoch_ns: UNIX time minus monotonic time.
    """
    aim = find_aim(learner, state)
    if isinstance(aim, Learnt) and mono_ns - proposer.refused_ns < PAUSE_NS:
        aim = "a design was refused"
    if isinstance(aim, str):
        return replace(proposer, design=None), make_no_design(mono_ns, epoch_ns, aim)
    held = proposer.held
    car = approach_learnt(proposer.at, aim, held.bounds, held.steps)
    near = proposer.design is not None and all(
        abs(a - b) <= STILL * most
        for a, b, most in zip(car, proposer.design.car, held.steps, strict=True)
    )
    if not near:
        file = held.file
        try:
            table = proposer.design_table(
                learnt_car(file, car), file.config, learnt_timing(file, car), file.profile.fastest
            )
            proposer = replace(proposer, design=Design(car, table))
        except DesignRefused as error:
            return replace(proposer, design=None), make_no_design(mono_ns, epoch_ns, str(error))
    if proposer.design is None or proposer.design.car == file_numbers(held):
        return proposer, make_no_design(mono_ns, epoch_ns, "the car is as in the car file")
    return proposer, make_design(mono_ns, epoch_ns, 1, proposer.design)


@dataclass
class Proposals:
    """A learner's proposals on their way."""

    proposer: Proposer  # what is proposed next
    send: Callable[[bytes, int], None]  # takes each as bytes, and when it was made [ns]

    def hear(self, taken: m.Design) -> None:
        """The core took a design, or the file's."""
        self.proposer = hear(self.proposer, taken)

    def propose(self, learner: Learner, state: State, t_ns: int, epoch_ns: int) -> None:
        """Propose at a report."""
        self.proposer, proposal = propose(self.proposer, learner, state, t_ns, epoch_ns)
        self.send(encode(proposal), t_ns)
