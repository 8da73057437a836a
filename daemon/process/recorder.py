"""The recorder process: records from the core's pipe into an MCAP session.

It ignores the terminal's signals and ends when the pipe closes, so that a stop is recorded to its
end. At most `[record] flush_ms` of a session is lost when it is killed.
"""

import json
import shutil
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.screen import describe_holes
from steerd.daemon.ipc.pipe_records import Gaps, PipeReader, PipeRecord
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.views import Views
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.session import FLUSH_NS, SessionWriter
from steerd.steer_bus.session_read import SessionError
from steerd.steer_bus.topics import TOPICS, make_session_topic

_POLL_MS = 50  # longest wait for records before the file and the disk are looked after [ms]
_REPORTS_MS = 2000  # longest pause after which the learner's last reports are not waited for [ms]
_DISK_CHECK_NS = 1_000_000_000
_BEHIND_NS = 1_000_000_000  # a pipe that ends so long after its last record was full before [ns]
_NEARLY_FULL = "disk nearly full"


class Recording:
    """One session being written, and what the pipe dropped (`gaps`).

    `written` counts the records; the first was sent at `start_ns` (UNIX). Each method raises
    SessionError where the disk takes no more.
    """

    def __init__(self, job: Mapping[str, Any]) -> None:
        self._topics = {topic.name: make_session_topic(job["car"], topic) for topic in TOPICS}
        attachments = {name: text.encode() for name, text in job["attachments"].items()}
        classes = {self._topics[topic.name]: topic.message for topic in TOPICS}
        times = int(job["start_ns"]), int(job.get("flush_ns", FLUSH_NS))
        path, metadata = Path(job["path"]), job["metadata"]
        self.writer = SessionWriter(path, classes, metadata, attachments, *times)
        self.written = 0
        self.gaps = Gaps()
        self.start_ns = 0
        self._views = Views()

    def take(self, record: PipeRecord) -> None:
        """Write one record of the core's pipe, and note what is missing before it."""
        self.gaps.take(record)
        self.start_ns = self.start_ns or record.log_time_ns
        self.add(record)

    def finish(self, reason: str) -> str:
        """End the file with why it ended and what is missing in it; say the latter in words.

        Raises:
            SessionError: the disk does not take it.
        """
        dropped, holes = str(self.gaps.missed), self.gaps.spans
        end = {"reason": reason, "written": str(self.written), "dropped": dropped}
        self.writer.finish(end | ({"holes": json.dumps(holes)} if holes else {}))
        return describe_holes(dropped, holes, self.start_ns)

    def add(self, record: PipeRecord) -> None:
        """Write one record, and the standard ROS message made of it."""
        for each in (record, *self._views.convert(record)):
            topic = self._topics[each.topic.name]
            self.writer.write(topic, each.data, each.log_time_ns, each.publish_time_ns)
            self.written += 1


def check_space(path: Path, disk_free_min: int) -> None:
    """Refuse a recording that would end as soon as it has begun.

    Raises:
        SessionError: there is less free space than a recording needs [bytes].
    """
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError as error:
        raise SessionError("disk", f"{path.parent}: {error.strerror}") from error
    if free < disk_free_min:
        what = f"{path.parent} has {free / 1e6:.0f} MB left, less than {disk_free_min / 1e6:.0f} MB"
        raise SessionError("disk", what, "free some space, or --record on another disk")


def record_pipe(
    recording: Recording, core: PipeReader, disk_free_min: int, learner: PipeReader
) -> str:
    """Write until the core's pipe closes or the disk is nearly full; return the reason.

    The learner's reports are written as they come; it may end before the drive.
    """
    clock = MonotonicClock()
    began_ns = last_ns = disk_due_ns = 0
    while True:
        core.wait(_POLL_MS)
        for record in core.take():
            recording.take(record)
            began_ns = began_ns or clock.now_ns()
            last_ns = record.log_time_ns
        now = clock.now_ns()
        if now >= disk_due_ns:
            disk_due_ns = now + _DISK_CHECK_NS
            if shutil.disk_usage(recording.writer.partial.parent).free < disk_free_min:
                core.close()
                return _NEARLY_FULL
        if core.fd is None:
            _note_end(recording, now - began_ns, last_ns)
            for record in learner.rest(_REPORTS_MS):
                recording.add(record)
            return "end of the run"
        _take_reports(recording, learner)
        if recording.writer.tick(now):
            # In a thread: the disk may be slow, the pipe must be read.
            threading.Thread(target=_sync, args=(recording.writer,), daemon=True).start()


def _note_end(recording: Recording, since_ns: int, last_ns: int) -> None:
    """Records can be missing behind the last: a recorder that stood still reads old ones only."""
    left_ns = since_ns - (last_ns - recording.start_ns)
    if recording.start_ns and left_ns > _BEHIND_NS:
        recording.gaps.add(last_ns, last_ns + left_ns)


def _take_reports(recording: Recording, reports: PipeReader) -> None:
    """Write what the learner reported; say when it has ended while the drive goes on."""
    there = reports.fd is not None
    for record in reports.take():
        recording.add(record)
    if there and reports.fd is None:
        print("steerd recorder: the learner ended; the drive goes on without it", file=sys.stderr)


def _sync(writer: SessionWriter) -> None:
    try:
        writer.sync()
    except (SessionError, ValueError):
        return  # the writing thread meets the same error and reports it


def serve(job: Job) -> int:
    """The process; it ends with the core's pipe."""
    meta, disk_free_min = job.about, int(job.about["disk_free_min"])
    try:
        check_space(Path(meta["path"]), disk_free_min)
        recording = Recording(meta)
        job.say_ready()
        core, learner = PipeReader(job.fds["pipe"]), PipeReader(job.fds.get("reports"))
        reason = record_pipe(recording, core, disk_free_min, learner)
        missing = recording.finish(reason)
    except SessionError as error:
        raise SteerdError(str(error), "", ExitCode.UNREADABLE) from None
    if missing:
        print(f"steerd recorder: {missing}", file=sys.stderr)
    if reason == _NEARLY_FULL:
        print(f"steerd recorder: {reason}; {recording.writer.path} is whole", file=sys.stderr)
        return ExitCode.UNREADABLE
    return ExitCode.OK


if __name__ == "__main__":
    run_process(serve)
