"""Progress of a long command: a bar on a terminal, nothing elsewhere."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

from steerd.daemon.common.screen import raw

T = TypeVar("T")
Advance = Callable[[float], None]  # called with the amount of work done, in the unit of the total


class Step(Protocol):
    """Called with the amount of work done, and the name of the next step where it has one."""

    def __call__(self, done: float, step: str = "", /) -> None:
        """Move the bar."""


def watched(items: Iterable[T], advance: Callable[[int], None], every: int = 500) -> Iterator[T]:
    """The items as they are; `advance` is called with their number at each of `every`."""
    for count, item in enumerate(items):
        if count % every == 0:
            advance(count)
        yield item


@contextmanager
def show_progress(label: str, total: float, *, even: bool = False) -> Iterator[Step]:
    """A bar on standard error if that is a terminal; work at an `even` rate shows the time left."""
    if not sys.stderr.isatty():
        yield lambda done, step="", /: None
        return
    from rich import progress as bars
    from rich.console import Console

    text = bars.TextColumn("{task.description}")
    # The spinner and the elapsed time move during a long step that reports no share of its own.
    columns = bars.SpinnerColumn("line"), text, bars.BarColumn(), bars.TaskProgressColumn()
    times = (bars.TimeElapsedColumn(), bars.TextColumn("left"), bars.TimeRemainingColumn())
    shown = (*columns, *(times if even else times[:1]))
    console = Console(file=raw(sys.stderr))
    with bars.Progress(*shown, console=console, transient=True) as progress:
        task = progress.add_task(label, total=total)

        def move(done: float, step: str = "", /) -> None:
            progress.update(task, completed=done, description=f"{label}: {step}" if step else None)

        yield move
