"""What `identify` and `diagnose` are asked, one frozen value each, and what commands find.

A notebook's keyword arguments are the fields of that value, and so are the parsed arguments of the
command line.
"""

import argparse
import inspect
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Concatenate, Literal, ParamSpec, TypeVar

from steerd.car_model.car_file import CarFile
from steerd.car_model.effects import find_effect
from steerd.daemon.common.errors import UsageError, load_car_file
from steerd.daemon.common.notebook import notebook_progress, speaking_of_arguments
from steerd.daemon.common.screen import Step, format_screen
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


EVERY = 4  # unless stated otherwise every 4th block or session is held out

Speed = Literal["command", "wheel"]
"""What drives the simulated car: the speed command, or the measured wheel speed."""


SessionSource = os.PathLike[str] | str  # a file's name, or what `load` and `simulate` give
SessionSources = SessionSource | Sequence[SessionSource]
CarSource = CarFile | Finding | Path | str | None
HeldOutSource = int | SessionSource | Sequence[int | SessionSource] | None


P = ParamSpec("P")
O = TypeVar("O")  # noqa: E741
R = TypeVar("R")


@dataclass
class Watch:
    """Who looks on while drives are worked on."""

    hear: Callable[[Sequence[str]], None] = lambda texts: None  # is handed warnings as they come
    progress: Step = lambda done, step="", /: None  # the share of the work done, the next step
    # The prediction (JSON), before the held-out drives are looked at
    written: Callable[[str], None] = lambda prediction: None
    warnings: list[str] = field(default_factory=list)  # so far

    def warn(self, texts: Sequence[str]) -> None:
        """Say what is wrong or doubtful in a session, as sentences; the work goes on."""
        self.warnings += texts
        self.hear(texts)


def by_keywords(
    label: str, options: Callable[P, O], work: Callable[[Sequence[Path], O, Watch], R]
) -> Callable[Concatenate[SessionSources, P], R]:
    """Work on sessions as a notebook's function: of any sources and the options' own keywords."""

    @speaking_of_arguments
    @wraps(work)
    def call(sessions: SessionSources, /, *args: P.args, **given: P.kwargs) -> R:
        with notebook_progress(label, 1.0) as progress:
            return work(list_sessions(sessions), options(*args, **given), Watch(progress=progress))

    first = inspect.Parameter(
        "sessions", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=SessionSources
    )
    keywords = inspect.signature(options).parameters.values()
    call.__dict__["__signature__"] = inspect.Signature([first, *keywords])
    asked = inspect.getmro(options)[:-1]  # type: ignore[arg-type]
    call.__doc__ = "\n".join(str(each.__doc__) for each in (work, *asked))
    call.__name__ = call.__qualname__ = work.__name__.removeprefix("run_")
    return call


def read_arguments(options: Callable[..., O], args: argparse.Namespace) -> O:
    """The options of a command line whose arguments are called as the fields."""
    return options(**{each.name: getattr(args, each.name) for each in fields(options)})  # type: ignore[arg-type]


@dataclass(frozen=True)
class HeldOut:
    """What validates: every k-th part (0 for none, None as usual), or whole sessions."""

    every: int | None = None
    files: tuple[Path, ...] = ()


def read_held_out(given: HeldOutSource) -> HeldOut:
    """What is held out.

    Raises:
        SteerdError: the number makes no sense, or stands beside files.
    """
    listed = _listed(() if given is None else given)
    numbers = [each for each in listed if isinstance(each, int)]
    files = list_sessions([each for each in listed if not isinstance(each, int)])
    every = numbers[0] if numbers else None
    if len(numbers) > 1 or (numbers and files):
        raise UsageError(f"held out {every}: every K-th part, or files, not both")
    if every is not None and (every < 0 or every == 1):
        what = f"held out {every}: every K-th part is held out, 2 or more"
        raise UsageError(what, "0 holds nothing out")
    return HeldOut(every, files)


def _listed(given: Any) -> Sequence[Any]:
    """One or several, as several."""
    return given if isinstance(given, Sequence) and not isinstance(given, str) else (given,)


def list_sessions(given: SessionSources) -> tuple[Path, ...]:
    """Session files, of one source or several."""
    return tuple(map(Path, _listed(given)))


def read_effects(names: Sequence[str]) -> tuple[str, ...]:
    """Effects by their own names; a name of none is refused."""
    try:
        return tuple(find_effect(name).name for name in names)
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise UsageError(what, hint) from None


def read_car(given: CarSource) -> CarFile:
    """A car; the F1TENTH car for None.

    Raises:
        SteerdError: the car file cannot be read, or says something impossible.
    """
    if isinstance(given, CarFile):
        return given
    return given.car if isinstance(given, Finding) else load_car_file(given)
