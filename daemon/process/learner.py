"""The learner process: what the core sends in, a report a second out to recorder and gateway.

It ends when the core's pipe closes. Nobody waits for it: both its pipes drop when full, and a drive
without it goes on.
"""

# Why: docs/decisions/processes-and-time.md#d79

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from steerd.controller.build import compute_table
from steerd.daemon.assembly.build import read_job
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.written import write_output, write_whole
from steerd.daemon.ipc.pipe_records import Gaps, PipeReader, PipeRecord, PipeWriter, pack_record
from steerd.daemon.ipc.requests import make_sender
from steerd.daemon.learning.feed import Feed, Wiring, make_feed, make_record, read_memory
from steerd.daemon.learning.kept import About, Keeper
from steerd.daemon.learning.proposing import Proposals
from steerd.daemon.process.child import Job, run_process
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import CodecError, decode


class LearnerLoop:
    """Records in, reports out; the keeper writes what is learnt beside the car file."""

    def __init__(
        self, feed: Feed, outputs: Sequence[PipeWriter], keeper: Keeper | None = None
    ) -> None:
        self.feed = feed
        self.outputs = outputs
        self.keeper = keeper
        self.reports = 0
        self._gaps = Gaps()

    def take(self, records: Iterable[PipeRecord]) -> None:
        """Take in records; one that does not decode is as good as dropped."""
        for record in records:
            self._gaps.take(record)
            self.feed.dropped = self._gaps.missed
            try:
                message = decode(record.topic.message, record.data)
            except CodecError:
                continue
            report = self.feed.take(record.topic, message)
            if report is not None:
                self._send(report, record.log_time_ns)
                if self.keeper is not None:
                    self.keeper.take(report)

    def _send(self, report: m.Model, log_time_ns: int) -> None:
        packed = pack_record(make_record(report, self.reports, log_time_ns))
        self.reports += 1
        for output in self.outputs:
            output.write([packed], report.mono_ns)


def make_keeper(job: Mapping[str, Any]) -> Keeper | None:
    """Who keeps what the job's learner learns; None for simulated hardware."""
    if not job["page"]:
        return None
    page, refused = Path(job["page"]), bool(job["refused"])

    def write(text: str) -> None:
        nonlocal refused
        page.parent.mkdir(parents=True, exist_ok=True)
        if refused:  # whatever is there is somebody's
            write_output(page, text)
        else:
            write_whole(page, text)
        refused = False

    def complain(text: str) -> None:
        print(f"steerd learner: {text}; the drive goes on", file=sys.stderr)

    return Keeper(About(*job["about"]), write, complain)


def serve(given: Job) -> int:
    """The process; it ends with the core's pipe, and keeps what was learnt.

    Raises:
        SteerdError: it cannot learn this car.
    """
    given.say_ready()  # nobody waits for it
    job, fds = given.about, given.fds
    plan = read_job(job)
    if plan.settings.file.remark:
        print(f"steerd learner: {plan.settings.file.remark}", file=sys.stderr)
    try:
        wiring = Wiring(plan.run.epoch_ns, plan.settings.scaling)
        feed = make_feed(plan.settings.file, wiring, read_memory(job["memory"]))
    except ValueError as error:
        raise SteerdError(str(error)) from None
    if plan.learnt is not None:
        send = make_sender(fds["designs"])
        feed.proposals = Proposals(plan.learnt, compute_table, lambda data, _t_ns: send(data))
    outputs = [PipeWriter(fd) for name, fd in fds.items() if name.startswith("to_")]
    loop, records = LearnerLoop(feed, outputs, make_keeper(job)), PipeReader(fds["pipe"])
    while records.wait():
        loop.take(records.take())
    if loop.keeper is not None:
        loop.keeper.end()
    return 0


if __name__ == "__main__":
    run_process(serve)
