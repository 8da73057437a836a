"""For each watchdog a cell in which nothing but the outside world is changed.

A signal, a pipe, a byte, a socket, a clock, the car, the floor, the car file: never the field that
the fault should have set. Most cells of `trace.py` are such cells; where one is brought about
within the program, this file names another.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.settings.run_options import RunOptions
from tests.safety.catalogue import BY_CODE
from tests.safety.matrix import run_cell
from tests.safety.rig import make_rig
from tests.safety.trace import silenced

DRIVE_S = 20.0


@dataclass(frozen=True)
class OtherWorld:
    """A drive of another car than the car file's, or with another car file."""

    changed: str  # what of the world, in words
    path: str
    speed: float  # of the drive [m/s]
    car: Mapping[str, float] = field(default_factory=dict)  # of the simulated car
    safety: Mapping[str, Any] = field(default_factory=dict)  # the car file's `[safety]`
    behind: tuple[str, ...] = ()  # watchdogs that would trip earlier; silenced

    def drive(self) -> str:
        """Why the car was stopped."""
        settings = make_plan(RunOptions(car_file="", path=self.path, speed=self.speed)).settings
        settings = replace(settings, thresholds=replace(settings.thresholds, **self.safety))
        with silenced(*self.behind):
            rig = make_rig(self.path, self.speed, settings, car=self.car)
            rig.drive_off()
            rig.until(lambda r: r.state is not SupervisorState.RUNNING, DRIVE_S)
        return rig.notes.transitions[-1][1].text


@dataclass(frozen=True)
class OtherCell:
    """A cell of the matrix in which others would trip earlier; they are silenced."""

    code: str
    phase: str
    behind: tuple[str, ...]

    @property
    def changed(self) -> str:
        return f"{BY_CODE[self.code].name} (without {', '.join(self.behind)})"

    def drive(self) -> str:
        """Why the car was stopped."""
        with silenced(*self.behind):
            return run_cell(BY_CODE[self.code], self.phase).reasons[0]


class Elsewhere(NamedTuple):
    """A test with processes, or of the runner: what is changed, and a test's or a cell's name."""

    changed: str
    shown: str


WEAK = {"steer_gain": 0.8}
CIRCLE = "circle:radius=1.12"
DRIVES: dict[str, OtherWorld | OtherCell] = {
    "W6": OtherCell("C2", "P5", ("W5", "W31")),
    "W17": OtherWorld("linkage turns 20 % less", CIRCLE, 2.0, WEAK, behind=("W23",)),
    "W18": OtherWorld(
        "linkage turns 20 % less; car file allows 10 deg", CIRCLE, 2.0, WEAK,
        {"heading": 0.175, "heading_warn": 0.09},
    ),
    "W19": OtherWorld(
        "car file with a fence across the lane", "line", 2.0,
        safety={"fence": ((-1.0, -2.0), (6.0, -2.0), (6.0, 2.0), (-1.0, 2.0))},
    ),
    "W23": OtherWorld("slippery floor (mu 0.28)", CIRCLE, 2.0, {"mu": 0.28}),
}  # fmt: skip
ELSEWHERE = {
    "W16": Elsewhere("guardian killed, guardian frozen", "SIGSTOP guardian"),
    "W26": Elsewhere("recorder killed, recorder frozen; a pipe that nobody reads",
                     "SIGSTOP recorder"),
    "W27": Elsewhere("gateway killed, gateway frozen; a pipe that nobody reads", "SIGSTOP gateway"),
    "W28": Elsewhere("the boot clock steps", "test_w28_a_machine_that_slept"),
    "W29": Elsewhere("the limit of open files is lowered",
                     "test_w29_the_kernel_gives_no_descriptor_for_a_guardian"),
}  # fmt: skip


def list_outside() -> dict[str, str]:
    """What of the world is changed for a watchdog whose cell in `trace.py` is not such a cell."""
    changed = {id: drive.changed for id, drive in DRIVES.items()}
    return changed | {id: each.changed for id, each in ELSEWHERE.items()}
