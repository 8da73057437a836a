"""Many independent pieces of work side by side."""

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def map_jobs(work: Callable[[T], R], items: Iterable[T], jobs: int = 1) -> list[R]:
    """Do a piece of work for every item; results in the items' order.

    Args:
        work: a module-level function.
        items: its arguments.
        jobs: processes.
    """
    todo = list(items)
    if jobs <= 1 or len(todo) <= 1:
        return [work(item) for item in todo]
    from joblib import Parallel, delayed

    with quiet_workers():
        return list(Parallel(n_jobs=jobs)(delayed(work)(item) for item in todo))


@contextmanager
def quiet_workers() -> Iterator[None]:
    """Inside, joblib says nothing of workers that make way for fresh ones.

    A worker that has grown by 300 MB since its first piece of work ends, as when kernels are
    loaded. No work is lost by that, and no user can do anything about it.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        yield
