"""A writer that is killed loses at most the last quarter of a second."""

import os
import signal
import subprocess
import sys

import pytest

from steerd.steer_bus.messages import ClockSample
from steerd.steer_bus.session import open_session, recover

WRITER = """
import sys
from pathlib import Path
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import ClockSample, make_header
from steerd.steer_bus.session import SessionWriter

clock = MonotonicClock()
writer = SessionWriter(Path(sys.argv[1]), {"/clock": ClockSample}, {"steerd.session": {}})
start = due = clock.now_ns()
while True:
    due += 1_000_000
    clock.sleep_until_ns(due)
    now = clock.now_ns()
    message = ClockSample(make_header(now, "map"), now, now, 0)
    writer.write("/clock", encode(message), now)
    writer.tick(now)
    sys.stdout.buffer.write(now.to_bytes(8, "little"))
    sys.stdout.buffer.flush()
"""


@pytest.mark.realtime
@pytest.mark.parametrize("progress_ns", [700_000_000, 1_120_000_000])
def test_sigkill_loses_at_most_three_tenths_of_a_second(tmp_path, progress_ns):
    path = tmp_path / "a.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        first = last = int.from_bytes(process.stdout.read(8), "little")
        while last - first < progress_ns:
            last = int.from_bytes(process.stdout.read(8), "little")
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read()
        process.wait()
    last = int.from_bytes(rest[-8:], "little") if rest else last
    partial = path.with_name("a.mcap.partial")
    session = open_session(partial)
    assert session.warnings[-1].code == "unfinished"
    assert "steerd.session" in session.info().metadata
    times = session.columns(ClockSample)["monotonic_ns"]
    assert last - times[-1] <= 300_000_000
    assert recover(partial, path).messages == len(times)
