"""What a notebook may hand over for a session, a car or what is held out, as plain values."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from steerd.car_model.car_file import CarFile, default_car_path
from steerd.daemon.analysis.drives import load_base
from steerd.daemon.analysis.held_out import HeldOut


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
CarSource = CarFile | HasCar | Path | str | None
HeldOutSource = int | SessionSource | Sequence[SessionSource] | None


def list_sessions(given: SessionSource | Sequence[SessionSource]) -> tuple[Path, ...]:
    """Session files, of one source or several."""
    if isinstance(given, str | Path) or not isinstance(given, Sequence):
        given = (given,)
    return tuple(Path(each) if isinstance(each, str | Path) else each.path for each in given)


def make_held_out(given: HeldOutSource) -> HeldOut:
    """What is held out: every k-th part, sessions, or (None) what is usual.

    Raises:
        SteerdError: the number makes no sense.
    """
    if given is None:
        return HeldOut()
    if isinstance(given, int):
        return HeldOut(every=given)
    return HeldOut(files=list_sessions(given))


def read_car(given: CarSource) -> CarFile:
    """A car; the F1TENTH car for None.

    Raises:
        SteerdError: the car file cannot be read, or says something impossible.
    """
    if given is None:
        return load_base(default_car_path())
    if isinstance(given, CarFile):
        return given
    if isinstance(given, str | Path):
        return load_base(given)
    return given.car
