"""What commands find, and everything that shows it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from steerd.car_model.car_file import CarFile
from steerd.daemon.common.screen import format_screen
from steerd.daemon.common.written import car_outputs, check_outputs, write_outputs
from steerd.posterior_file import posterior_path
from steerd.sysid.report.report import Card, Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Reported(ABC):
    """What was found, and the page that shows it."""

    @abstractmethod
    def make_report(self) -> Report:
        """What screen, page and figure show."""

    @property
    def cards(self) -> Sequence[Card]:
        """The figures that the report shows first."""
        return self.make_report().cards

    def render_report(self) -> str:
        """The report as a page, one file."""
        from steerd.sysid.report.page import render_report

        return render_report(self.make_report())


class Finding(Reported):
    """What was found in drives: screen, page, figure, JSON values and car file."""

    SCREEN: ClassVar[int] = 0  # lines of the screen at most; 0 for as many as there are
    CAR: ClassVar[str]  # what messages call the car before it has a file

    @abstractmethod
    def make_report(self, written: Path | None = None, report: Path | None = None) -> Report:
        """The same; `written` and `report` are the files that were."""

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
        """Write the car file and what is known of the car beside it, each whole or not at all.

        A file that steerd did not write is kept.

        Raises:
            SteerdError: it cannot be written there.
        """
        path = Path(path)
        check_outputs({"save_car": path, "beside it": posterior_path(path)})
        known = self.car.posterior
        write_outputs(car_outputs(path, replace(self.make_car(path), posterior=known)))
        return path

    def __str__(self) -> str:
        return self.describe()

    def describe(self, written: Path | None = None, report: Path | None = None) -> str:
        """The screen; `written` and `report` are the files that were."""
        return format_screen(self.make_report(written, report).screen, self.SCREEN)

    def plot(self) -> "Figure":
        """The report's main diagrams as one figure."""
        from steerd.sysid.report.drawing import plot_report

        report = self.make_report()
        return plot_report(report.verdict, list(report.figures))
