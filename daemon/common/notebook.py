"""How steerd behaves in a notebook: progress, frames with units, words of arguments."""

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from steerd.daemon.common.errors import SteerdError, UsageError
from steerd.daemon.common.screen import Step

if TYPE_CHECKING:
    import pandas

T = TypeVar("T")
P = ParamSpec("P")
_OPTION = re.compile(r"`[^`]*`|(?<!\w)--([a-z][a-z-]*)(?:[ =]([\w./]+)(?=$|[:,;]))?")
_ARGUMENTS = {"effect": "effects"}  # arguments that are not called as their option


def speaking_of_arguments(function: Callable[P, T]) -> Callable[P, T]:
    """A function whose errors call arguments by their names, not by the command's options."""

    @wraps(function)
    def call(*args: P.args, **given: P.kwargs) -> T:
        try:
            return function(*args, **given)
        except SteerdError as error:
            what, hint = (_OPTION.sub(_as_argument, text) for text in (error.what, error.hint))
            raise SteerdError(what, hint, error.code) from error

    return call


def _as_argument(option: re.Match[str]) -> str:
    if option[1] is None:  # a command to copy
        return option[0]
    name = option[1].replace("-", "_")
    name = _ARGUMENTS.get(name, name)
    if option[2] is None:
        return name
    number = re.fullmatch(r"-?[\d.]+", option[2])
    return f"{name}={option[2] if number else repr(option[2])}"


def load_package(name: str) -> Any:
    """A package that only notebooks need; a SteerdError where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        what, hint = f"{name} is not installed", f"pip install {name}"
        raise UsageError(what, hint) from None


@contextmanager
def notebook_progress(label: str, total: float) -> Iterator[Step]:
    """A bar below the cell while the block runs; nothing outside a notebook."""
    shell = import_module("IPython").get_ipython() if "ipykernel" in sys.modules else None
    if not hasattr(shell, "kernel"):  # a program may import ipykernel outside one too
        yield lambda done, step="", /: None
        return
    ipython: Any = import_module("IPython.display")
    bar = ipython.display(ipython.HTML(label), display_id=True)

    def move(done: float, step: str = "", /) -> None:
        text = escape(f"{label}: {step}" if step else label)
        bar.update(ipython.HTML(f'<progress max="{total}" value="{done}"></progress> {text}'))

    try:
        yield move
    finally:
        bar.update({"text/html": "", "text/plain": ""}, raw=True)


def make_frame(columns: Mapping[str, Any], units: Mapping[str, str]) -> "pandas.DataFrame":
    """A data frame, `attrs["units"]` its units by column; a SteerdError without pandas."""
    frame: pandas.DataFrame = load_package("pandas").DataFrame(columns)
    frame.attrs["units"] = {name: units[name] for name in columns if units.get(name)}
    return frame
