"""Many independent pieces of work side by side."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def map_jobs(work: Callable[[T], R], items: Sequence[T], jobs: int) -> list[R]:
    """What a module-level function makes of every item, in their order, by so many processes."""
    if jobs <= 1 or len(items) <= 1:
        return [work(item) for item in items]
    from joblib import Parallel, delayed

    with quiet_workers():
        return list(Parallel(n_jobs=jobs)(delayed(work)(item) for item in items))


@contextmanager
def quiet_workers() -> Iterator[None]:
    """Inside, joblib says nothing of workers that make way for fresh ones.

    A worker that has grown by 300 MB since its first piece of work ends, as when kernels are
    loaded. No work is lost by that, and no user can do anything about it.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        yield
