"""How far a long command is: a bar on a terminal, silence elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

Advance = Callable[[float], None]
"""Told how much is done, in the unit of the total."""


class Step(Protocol):
    """Told how much is done, and what is done next where that has a name."""

    def __call__(self, done: float, step: str = "", /) -> None:
        """Move the bar."""


@contextmanager
def show_progress(label: str, total: float) -> Iterator[Step]:
    """A bar on standard error while the block runs, if somebody can see it."""
    if not sys.stderr.isatty():
        yield lambda done, step="", /: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn()
    console = Console(stderr=True)
    # The time so far moves on where a step is long and says nothing of its share.
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as progress:
        task = progress.add_task(label, total=total)

        def move(done: float, step: str = "", /) -> None:
            progress.update(task, completed=done, description=f"{label}: {step}" if step else None)

        yield move
