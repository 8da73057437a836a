"""Work units side by side, each a row: on this machine by joblib, or on a Dask cluster.

A unit that fails is a result and ends nothing. What fails for want of something that may come back
(a file system, memory, a worker) is tried again. A worker that dies takes the units that it and its
neighbours held along; each is then done alone, so that only the one that kills workers is given up.
"""

import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.sysid.parallel import quiet_workers

TRIES = 3  # times that a unit is begun before it is given up
AHEAD = 4  # units that wait at a cluster for each of its workers: their content is in memory
_ANSWER = "10s"  # time that a scheduler has to answer

_AGAIN = ("lost", "pending")
"""A result that died with its worker before it was fetched: the scheduler computes it again."""

Work = Callable[[Any], dict[str, Any]]
"""A function of a module: what a unit is about to the columns of its row."""


class Done(NamedTuple):
    """A unit that has ended."""

    unit: str  # its name
    row: dict[str, Any] | None  # what its work gave; None where it failed
    failure: str  # why, one sentence; empty where it did not fail
    tries: int  # how often it was begun


@dataclass(frozen=True)
class Where:
    """Where the work is done."""

    jobs: int = 0  # processes on this machine; 0 for one per core
    dask: str | None = None  # address of a Dask scheduler, which then does all of it

    def __post_init__(self) -> None:
        if self.jobs < 0:
            raise UsageError(f"--jobs {self.jobs}: 1 or more; 0 for one process per core")

    @property
    def processes(self) -> int:
        """Processes on this machine."""
        return self.jobs or len(os.sched_getaffinity(0))


def run_units(
    work: Work,
    todo: Mapping[str, Any],
    where: Where,
    ship: Callable[[Any], Any] = lambda about: about,
) -> Iterator[Done]:
    """Do the work with every argument, by the unit's name; results come as they end.

    `ship` makes an argument complete before it leaves for another machine.

    Raises:
        SteerdError: the cluster does not answer, or is lost.
    """
    if where.dask is not None:
        return _run_on_cluster(work, todo, where.dask, ship)
    if where.processes == 1 or len(todo) == 1:
        return (_try_unit(work, unit, about) for unit, about in todo.items())
    return _run_in_processes(work, todo, where.processes)


def _try_unit(work: Work, unit: str, about: Any) -> Done:
    """Do a unit, again where what it lacked may have come back."""
    failure = ""
    for attempt in range(1, TRIES + 1):
        try:
            return Done(unit, work(about), "", attempt)
        except SteerdError as error:
            return Done(unit, None, error.what, attempt)
        except (OSError, MemoryError) as error:
            failure = describe_failure(error)
        except Exception as error:
            return Done(unit, None, describe_failure(error), attempt)
    return Done(unit, None, failure, TRIES)


def _try_in_worker(work: Work, unit: str, about: Any) -> Done:
    """The same in a process of ours, which leaves Ctrl-C to its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _try_unit(work, unit, about)


def describe_failure(error: BaseException) -> str:
    """An exception as one line for a table."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


# -- this machine ----------------------------------------------------------------------------------


def _run_in_processes(work: Work, todo: Mapping[str, Any], jobs: int) -> Iterator[Done]:
    left, deaths = dict(todo), Counter[str]()
    while left:
        suspects = [unit for unit in left if deaths[unit]]
        batch = suspects[:1] or [*left]
        held: set[str] = set()
        try:
            for done in _dispatch(work, {unit: left[unit] for unit in batch}, jobs, held):
                held.discard(done.unit)
                del left[done.unit]
                yield done._replace(tries=done.tries + deaths[done.unit])
        except BrokenProcessPool:
            for unit in held & left.keys():
                deaths[unit] += 1
                if deaths[unit] >= TRIES:
                    del left[unit]
                    yield Done(unit, None, "its worker died each time", TRIES)


def _dispatch(work: Work, batch: Mapping[str, Any], jobs: int, held: set[str]) -> Iterator[Done]:
    """Results of a batch as they end; `held` is what workers have begun."""
    from joblib import Parallel, delayed

    def hand_out() -> Iterator[Any]:
        for unit, about in batch.items():
            held.add(unit)
            yield delayed(_try_in_worker)(work, unit, about)

    pool = Parallel(
        n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs"
    )
    with quiet_workers():
        yield from pool(hand_out())


# -- a cluster -------------------------------------------------------------------------------------


def _run_on_cluster(
    work: Work, todo: Mapping[str, Any], address: str, ship: Callable[[Any], Any]
) -> Iterator[Done]:
    try:
        import distributed
    except ImportError:
        raise UsageError("--dask needs Dask", "pip install distributed") from None
    dask: Any = distributed  # its functions carry no types
    try:
        client = dask.Client(address, timeout=_ANSWER, set_as_default=False)
    except (OSError, ValueError) as error:
        what = f"--dask {address}: {describe_failure(error)}"
        hint = "start a scheduler and workers, for instance with `dask scheduler`"
        raise SteerdError(what, hint, ExitCode.UNREACHABLE) from None
    with client, client.as_current():
        names: dict[str, str] = {}

        def hand_out() -> Iterator[Any]:
            """Each unit as a future, when its turn has come."""
            for unit, about in todo.items():
                future = client.submit(_try_unit, work, unit, ship(about), pure=False)
                names[future.key] = unit
                yield future

        waiting, ahead = hand_out(), AHEAD * max(1, sum(client.nthreads().values()))
        ended = dask.as_completed([*islice(waiting, ahead)])
        for future in ended:
            if future.status in _AGAIN:
                ended.add(future)
                continue
            unit = names.pop(future.key)
            if future.status == "finished":
                yield future.result()
            elif future.status == "error":  # its workers died each time
                yield Done(unit, None, describe_failure(future.exception()), TRIES)
            else:
                what, hint = "the scheduler is gone", "the same command goes on where it was"
                raise SteerdError(f"--dask {address}: {what}", hint, ExitCode.UNREACHABLE)
            future.release()
            ended.update([*islice(waiting, 1)])
