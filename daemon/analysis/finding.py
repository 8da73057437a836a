"""What `identify` and `diagnose` have in common: one finding, and everything that shows it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from steerd.car_model.car_file import CarFile
from steerd.daemon.analysis.car_output import save_car
from steerd.daemon.common.screen import format_screen
from steerd.sysid.report.report import Card, Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Finding(ABC):
    """What was found in drives: screen, page, figure, JSON values and car file."""

    SCREEN: ClassVar[int] = 0  # lines of the screen at most; 0 for as many as there are
    CAR: ClassVar[str]  # what messages call the car before it has a file

    @abstractmethod
    def make_report(self, written: Path | None = None, report: Path | None = None) -> Report:
        """What screen, page and figure show; `written` and `report` are the files that were."""

    @abstractmethod
    def make_car(self, path: Path) -> CarFile:
        """The car that was found; `path` is what messages call its file."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """JSON values of a versioned schema."""

    def learn_known(self, car: CarFile) -> CarFile:
        """The car of `make_car` with what is learnt for the file beside it: some seconds."""
        return car

    @cached_property
    def car(self) -> CarFile:
        """The car that was found: simulate with it, design from it, or diagnose against it.

        After `identify` it has the noise of its drives, which takes some seconds the first time.
        """
        return self.learn_known(self.make_car(Path(self.CAR)))

    def save_car(self, path: Path | str) -> Path:
        """Write the car file and what is known of the car, see `save_car`."""
        return save_car(Path(path), self.make_car(Path(path)), self.car)

    @property
    def cards(self) -> Sequence[Card]:
        """The figures that the report shows first."""
        return self.make_report().cards

    def __str__(self) -> str:
        return self.describe()

    def describe(self, written: Path | None = None, report: Path | None = None) -> str:
        """The screen; `written` and `report` are the files that were."""
        return format_screen(self.make_report(written, report).screen, self.SCREEN)

    def render_report(self) -> str:
        """The report as a page."""
        from steerd.sysid.report.page import render_report

        return render_report(self.make_report())

    def plot(self) -> "Figure":
        """The report's main diagrams as one figure."""
        from steerd.sysid.report.drawing import plot_report

        report = self.make_report()
        return plot_report(report.verdict, list(report.figures))
