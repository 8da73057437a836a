"""The learner process: what the core sends in, a report a second out to recorder and gateway.

It ends when the core's pipe closes. Nobody waits for it: both its pipes drop when full, and a drive
without it goes on.
"""

# Why: docs/decisions/processes-and-time.md#d79

import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

from steerd.daemon.assembly.build import RunPlan, read_job
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc import pipe_records as pipes
from steerd.daemon.ipc.requests import make_sender
from steerd.daemon.learning.feed import Proposals, Wiring, make_feed, make_record, read_memory
from steerd.daemon.learning.kept import About, Keeper
from steerd.daemon.process.child import Job, run_process
from steerd.steer_bus.codec import CodecError


class LearnerLoop:
    """A run's records in, a report a second out; designs of `--adapt` go to `propose`, with when.

    Raises:
        ValueError: the car file holds what identify does not write.
    """

    def __init__(
        self, plan: RunPlan, propose: Callable[[bytes, int], object], memory: str = ""
    ) -> None:
        wiring = Wiring(plan.run.epoch_ns, plan.settings.scaling)
        self.feed = make_feed(plan.settings.file, wiring, read_memory(memory))
        if plan.learnt is not None:
            self.feed.proposals = Proposals(plan.learnt, propose)
        self._gaps, self._numbers = pipes.Gaps(), count()

    def take(self, record: pipes.PipeRecord) -> pipes.PipeRecord | None:
        """The report that a record completes; one that does not decode is as good as dropped."""
        self._gaps.take(record)
        self.feed.dropped = self._gaps.missed
        try:
            message = pipes.read_message(record)
        except CodecError:
            return None
        report = self.feed.take(record.topic, message)
        return make_record(report, next(self._numbers), record.log_time_ns) if report else None


def serve(given: Job) -> int:
    """The process; it ends with the core's pipe, and keeps what was learnt."""
    given.say_ready()  # nobody waits for it
    job, fds = given.about, given.fds
    plan = read_job(job)
    if plan.settings.file.remark:
        print(f"steerd learner: {plan.settings.file.remark}", file=sys.stderr)
    send = make_sender(fds["designs"]) if "designs" in fds else lambda data: None
    try:
        loop = LearnerLoop(plan, lambda data, _t_ns: send(data), job["memory"])
    except ValueError as error:
        raise SteerdError(str(error)) from None
    outputs = [pipes.PipeWriter(fd) for name, fd in fds.items() if name.startswith("to_")]
    keeper, records = None, pipes.PipeReader(fds["pipe"])
    if job["page"]:  # of a car; simulated hardware's numbers are no car's
        keeper = Keeper(Path(job["page"]), About(*job["about"]), job["refused"])
    while records.wait():
        for report in filter(None, map(loop.take, records.take())):
            for output in outputs:
                output.write([pipes.pack_record(report)], report.message.mono_ns)
            if keeper is not None:
                keeper.take(report.message)
    if keeper is not None:
        keeper.end()
    return 0


if __name__ == "__main__":
    run_process(serve)
