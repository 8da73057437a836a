"""What `identify` and `diagnose` are asked: one frozen value each.

A notebook's keyword arguments are the fields of that value, and so are the parsed arguments of the
command line.
"""

import argparse
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, Literal, NamedTuple, ParamSpec, Protocol, TypeVar

from steerd.car_model.car_file import CarFile, default_car_path
from steerd.car_model.effects import find_effect
from steerd.daemon.common.errors import UsageError, load_car_file
from steerd.daemon.common.notebook import notebook_progress, speaking_of_arguments
from steerd.daemon.common.progress import Step

EVERY = 4
"""Unless stated otherwise every 4th block or session is held out."""

Speed = Literal["command", "wheel"]
"""What drives the simulated car: the speed command, or the measured wheel speed."""


class HasPath(Protocol):
    """A recorded session: anything with its file."""

    @property
    def path(self) -> Path:
        """The session file."""


class HasCar(Protocol):
    """An identification: anything with a car."""

    @property
    def car(self) -> CarFile:
        """The car."""


SessionSource = Path | str | HasPath
SessionSources = SessionSource | Sequence[SessionSource]
CarSource = CarFile | HasCar | Path | str | None
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


class HeldOut(NamedTuple):
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
    return tuple(Path(e) if isinstance(e, str | Path) else e.path for e in _listed(given))


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
    if given is None or isinstance(given, str | Path):
        return load_car_file(given or default_car_path())
    return given.car
