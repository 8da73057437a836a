"""Designs for cars near that of the car file, for all tests of what follows the learner."""

from functools import lru_cache

from steerd.controller import learnt
from steerd.controller.acceptance import Acceptance, check_design, make_acceptance
from steerd.controller.gains import design_table
from steerd.controller.lane_controller import LaneController
from steerd.controller.learnt import Design, Learnt
from steerd.daemon.assembly.build import RunPlan, make_plan
from steerd.daemon.settings.run_options import RunOptions


def make_adapt_plan(**options) -> RunPlan:
    """A simulated figure-eight with `--learn --adapt`."""
    given = {
        "car_file": "", "path": "figure8", "speed": 1.5, "simulated": True, "auto_arm": True,
        "learn": True, "adapt": True,
    }  # fmt: skip
    return make_plan(RunOptions(**(given | options)))


@lru_cache(1)
def standard() -> Acceptance:
    """What designs beside the standard car's are held against."""
    plan = make_adapt_plan()
    return make_acceptance(plan.controller)


def numbers(held: Acceptance, **changed: float) -> Learnt:
    """The file's numbers with some changed."""
    return learnt.learnt_of(held.file.car)._replace(**changed)


def design_for(held: Acceptance, **changed: float) -> Design:
    """The lane keeper's own design for these numbers."""
    file, car = held.file, numbers(held, **changed)
    believed, timing = learnt.learnt_car(file, car), learnt.learnt_timing(file, car)
    table = design_table(believed, file.config, timing, file.profile.fastest)
    return Design(car, table)


def scaled(design: Design, factor: float, first: int = 0, last: int = 5) -> Design:
    """With some of the feedback gains in all rows multiplied."""
    rows = tuple(
        (*row[:first], *(factor * gain for gain in row[first:last]), *row[last:])
        for row in design.table.rows
    )
    return design._replace(table=design.table._replace(rows=rows))


def accept(held: Acceptance, now: Learnt, design: Design) -> LaneController | str:
    """The controller of a design, or why it is refused."""
    problem = next(filter(None, check_design(held, now, design)), "")
    return problem or learnt.follow_learnt(held.file, design)
