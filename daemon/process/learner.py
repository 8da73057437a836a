"""The learner process: what the core sends in, a report a second out to recorder and gateway.

It ends when the core's pipe closes. Nobody waits for it: both its pipes drop when full, and a drive
without it goes on.
"""

# Why: docs/decisions/processes-and-time.md#d79

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import parse_car
from steerd.controller.build import compute_table
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.written import write_output, write_whole
from steerd.daemon.ipc.pipe_records import Gaps, PipeWriter, pack_record, unpack_records
from steerd.daemon.ipc.requests import make_sender
from steerd.daemon.learning.feed import Feed, Wiring, make_feed, make_record, read_memory
from steerd.daemon.learning.kept import About, Keeper
from steerd.daemon.learning.proposing import Proposals, make_proposer
from steerd.daemon.process.child import Job, run_child
from steerd.daemon.settings.run_options import decode_options
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import CodecError, decode

_READ_BYTES = 1 << 16


class LearnerLoop:
    """Records in, reports out.

    Attributes:
        feed: the learner.
        outputs: where reports go.
        keeper: writes what is learnt beside the car file, or None.
        reports: how many there were.
    """

    def __init__(
        self, feed: Feed, outputs: Sequence[PipeWriter], keeper: Keeper | None = None
    ) -> None:
        self.feed = feed
        self.outputs = outputs
        self.keeper = keeper
        self.reports = 0
        self._gaps = Gaps()

    def take(self, buffer: bytearray) -> None:
        """Take in every whole record; one that does not decode is as good as dropped."""
        for record in unpack_records(buffer):
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

    def end(self) -> None:
        """The drive is over: keep what was learnt."""
        if self.keeper is not None:
            self.keeper.end()

    def _send(self, report: m.Model, log_time_ns: int) -> None:
        packed = pack_record(make_record(report, self.reports, log_time_ns))
        self.reports += 1
        for output in self.outputs:
            output.write([packed], report.mono_ns)


def make_learner_feed(job: Mapping[str, Any]) -> Feed:
    """The feed of a job, see `make_learner_job`.

    Raises:
        ValueError: the car file holds what identify does not write.
    """
    wiring = Wiring(int(job["epoch_ns"]), float(job["erpm_gain"]), float(job["erpm_offset"]))
    car = parse_car(job["car"], Path(job["path"]), job.get("posterior", ""))
    if car.remark:
        print(f"steerd learner: {car.remark}", file=sys.stderr)
    return make_feed(car, wiring, read_memory(job.get("memory", "")))


def make_keeper(job: Mapping[str, Any]) -> Keeper | None:
    """Who keeps what the job's learner learns; None for simulated hardware."""
    if not job.get("page"):
        return None
    page, refused = Path(job["page"]), bool(job["page_refused"])

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


def _make_proposals(options: str, fd: int) -> Proposals:
    """Proposals to the core's end of a socket.

    Raises:
        SteerdError: the plan cannot be made again, as the core could.
    """
    send, held = make_sender(fd), make_plan(decode_options(options)).learnt
    return Proposals(make_proposer(held, compute_table), lambda data, _t_ns: send(data))


def serve_job(given: Job) -> int:
    """Learn until the pipe closes; the exit code."""
    job, fds = given.about, given.fds
    try:
        feed = make_learner_feed(job)
        if job["adapt"]:
            feed.proposals = _make_proposals(job["adapt"], fds["designs"])
    except ValueError as error:
        print(f"steerd learner: {error}", file=sys.stderr)
        return 4
    given.say_ready("ready")
    outputs = [PipeWriter(fd) for name, fd in fds.items() if name.startswith("to_")]
    loop, buffer = LearnerLoop(feed, outputs, make_keeper(job)), bytearray()
    while data := os.read(fds["pipe"], _READ_BYTES):
        buffer += data
        loop.take(buffer)
    loop.end()
    return 0


if __name__ == "__main__":
    sys.exit(run_child(serve_job))
