"""Whether a proposed design may be taken: pure, in pieces short enough to fit between two ticks.

Whoever proposes is not believed. Numbers must lie within bounds and near those in force; the table
must have the grid and width of a design for them; what it steers in a turn must be that car's; and
at every speed of the check the loop must be stable with distance to spare on the car as proposed,
and stable on the car of the file. What is taken can then do no worse than a design for a car
within the bounds.
"""

# Why: docs/decisions/filter-and-controller.md#d85

from collections.abc import Iterator
from functools import lru_cache
from math import isfinite
from typing import NamedTuple

from steerd.car_model.params import Car
from steerd.controller.design import assessed_speeds, find_faults, margins, stability_at
from steerd.controller.gain_table import N_LANE, N_TURNING, look_up
from steerd.controller.lane_controller import LaneController
from steerd.controller.learnt import (
    Design,
    Learnt,
    LearntBounds,
    learnt_car,
    learnt_timing,
    make_bounds,
    steps,
)
from steerd.controller.loop_model import Timing, sampled_loop, turn_response

DISTANCE = 0.5
"""Least distance from -1: gain may be doubled, or a third be missing; 29 degrees of phase."""
NEAR_FILE = 0.8  # or this share of the file's own design at its worst, where that is less
LARGEST = 1e4  # no gain of any design is larger, in SI units
_NEAR = 1e-6  # relative difference that another machine's arithmetic may make


class Acceptance(NamedTuple):
    """What a design is compared with."""

    file: LaneController  # the controller of the car file
    bounds: LearntBounds  # of the numbers
    steps: Learnt  # how far they may be from those in force
    distance: float  # least distance from -1


def make_acceptance(file: LaneController) -> Acceptance:
    """What designs beside that of the car file are compared with."""
    table, timing = file.table, file.report.timing
    own = min(
        margins(file.car, look_up(table, v), table.pasts, v, timing)[1]
        for v in assessed_speeds(table)
    )
    distance = min(DISTANCE, NEAR_FILE * own)
    return Acceptance(file, make_bounds(file.car), steps(file.car), distance)


def check_design(held: Acceptance, now: Learnt, design: Design) -> Iterator[str]:
    """The check piece by piece: nothing for one that passes, and the last is why it is refused.

    The proposal's numbers are compared with those in force `now`.
    """
    problem = _check_numbers(held, now, design) or _check_table(held, design)
    yield problem
    if problem:
        return
    for piece in (_check_turns, _check_as_proposed, _check_on_file):
        for found in piece(held, design):
            yield found
            if found:
                return


def _check_numbers(held: Acceptance, now: Learnt, design: Design) -> str:
    rows = zip(Learnt._fields, design.car, now, held.steps, *held.bounds, strict=True)
    for name, value, at, most, low, high in rows:
        if not low <= value <= high:  # not a number is in no bounds
            return f"{name} {value:.4g} is not within {low:.4g} to {high:.4g}"
        if abs(value - at) > most * (1.0 + _NEAR):
            return f"{name} {value:.4g} is too far from {at:.4g}, which is in force"
    return ""


def _check_table(held: Acceptance, design: Design) -> str:
    table, own = design.table, held.file.table
    if (table.speed_min, table.spacing, len(table.rows)) != (
        own.speed_min, own.spacing, len(own.rows),
    ):  # fmt: skip
        return "its speeds are not those of the car file's design"
    if not all(isfinite(gain) and abs(gain) < LARGEST for row in table.rows for gain in row):
        return "a gain is no number, or absurd"
    width = N_LANE + N_TURNING + _pasts_of(held, design)
    if any(len(row) != width for row in table.rows):
        return "its gains are not as many as its dead time needs"
    return ""


def _pasts_of(held: Acceptance, design: Design) -> int:
    """How many past references a design for these numbers feeds back."""
    if held.file.report.design == "pole_placement":
        return 0
    car, timing = learnt_car(held.file, design.car), learnt_timing(held.file, design.car)
    return _pasts_for(car, held.file.table.speed_min, timing)


@lru_cache(16)
def _pasts_for(car: Car[float], speed: float, timing: Timing) -> int:
    a, _ = sampled_loop(car, speed, timing)
    return len(a) - (N_LANE if timing.lagging else 4)


def _check_turns(held: Acceptance, design: Design) -> Iterator[str]:
    car = learnt_car(held.file, design.car)
    for speed, row in zip(design.table.speeds, design.table.rows, strict=True):
        own = turn_response(car, speed)
        same = all(
            abs(a - b) <= _NEAR * (1.0 + abs(b)) for a, b in zip(row[-N_TURNING:], own, strict=True)
        )
        yield "" if same else f"at {speed:.2f} m/s it turns as another car would"


def _check_as_proposed(held: Acceptance, design: Design) -> Iterator[str]:
    car, timing = learnt_car(held.file, design.car), learnt_timing(held.file, design.car)
    for speed in assessed_speeds(design.table):
        row = look_up(design.table, speed)
        found, distance = margins(car, row, design.table.pasts, speed, timing)
        if find_faults([found], held.file.config.damping_min):
            yield f"at {speed:.2f} m/s it is unstable, or too little damped"
        elif not distance >= held.distance:
            yield f"at {speed:.2f} m/s its margin is {distance:.2f}, under {held.distance:.2f}"
        else:
            yield ""


def _check_on_file(held: Acceptance, design: Design) -> Iterator[str]:
    timing = held.file.report.timing
    for speed in assessed_speeds(design.table):
        radius = stability_at(held.file.car, design.table, speed, timing).radius
        stable = radius < 1.0
        yield "" if stable else f"at {speed:.2f} m/s it is unstable on the car of the car file"
