"""Many independent pieces of work side by side: joblib on this machine, Dask on others."""

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def map_jobs(
    work: Callable[[T], R], items: Iterable[T], jobs: int = 1, dask: str | None = None
) -> list[R]:
    """Do a piece of work for every item; results in the items' order.

    Args:
        work: a module-level function.
        items: its arguments.
        jobs: processes on this machine.
        dask: address of a Dask scheduler, which then does all of it.

    Raises:
        ImportError: a scheduler is named but Dask is not installed.
        OSError: the scheduler does not answer.
    """
    todo = list(items)
    if dask is not None:
        return _map_dask(work, todo, dask)
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


def _map_dask(work: Callable[[T], R], todo: list[T], address: str) -> list[R]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError("--dask needs Dask: pip install distributed") from error
    with Client(address, timeout="10s", set_as_default=False) as client:  # type: ignore[no-untyped-call]
        results: list[R] = client.gather(client.map(work, todo, pure=False))
        return results
