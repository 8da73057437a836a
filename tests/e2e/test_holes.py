"""A recorder that stood still: the session says what it lacks, and nobody fits across it."""

import contextlib
import io
import os
import threading

import pytest

from steerd.daemon.analysis.drives import load_drive
from steerd.daemon.analysis.options import Watch
from steerd.daemon.cli.main import run_cli
from steerd.daemon.ipc import pipe_records
from steerd.daemon.process.recorder import Recording, record_pipe
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.topics import find_topic
from steerd.sysid.data.dataset import read_run
from steerd.sysid.data.segments import pauses

pytestmark = pytest.mark.slow

NS = 1_000_000_000
FROM, UNTIL = 8.0, 14.0  # when the recorder stands still [s]; a pipe takes some seconds more


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "whole.mcap"
    with contextlib.redirect_stdout(io.StringIO()):
        words = ["run", "--sim", "--fast", "--path", "figure8", "--speed", "1.5"]
        assert run_cli([*words, "--duration", "20", "--record", str(path)]) == 0
    return path


def ticks(session):
    """The records of a session as the core sends them: those of one time together."""
    batch = []
    for r in session.messages():
        topic, times = find_topic(r.topic), (r.log_ns, r.publish_ns)
        record = pipe_records.PipeRecord(topic, r.sequence, *times, r.data)
        if batch and batch[-1].log_time_ns != record.log_time_ns:
            yield batch
            batch = []
        batch.append(record)
    yield batch


def through_a_pipe(whole, out, still):
    """Record a session again through the core's pipe, of which nobody reads for a while."""
    session = open_session(whole)
    start_ns = session.info().start_ns
    read_fd, write_fd = pipe_records.make_pipe()
    writer, came = pipe_records.PipeWriter(write_fd), bytearray()
    os.set_blocking(read_fd, False)
    for batch in ticks(session):
        writer.write([pipe_records.pack_record(record) for record in batch], batch[0].log_time_ns)
        if not still[0] <= (batch[0].log_time_ns - start_ns) / NS < still[1]:
            with contextlib.suppress(BlockingIOError):
                while data := os.read(read_fd, 1 << 20):
                    came += data
    meta = {"path": out, "car": "car1", "metadata": session.info().metadata, "start_ns": 0}
    meta["attachments"] = {a.name: a.data.decode() for a in session.attachments()}
    recording = Recording(meta)
    ours, theirs = os.pipe()

    def send():
        with os.fdopen(theirs, "wb") as end:
            end.write(came)

    thread = threading.Thread(target=send)
    thread.start()
    reason = record_pipe(recording, pipe_records.PipeReader(ours), 0, pipe_records.PipeReader(None))
    thread.join()
    for fd in (read_fd, write_fd):
        os.close(fd)
    return recording.finish(reason), writer.dropped


@pytest.fixture(scope="module")
def holed(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("holed") / "holed.mcap"
    return path, *through_a_pipe(drive, path, (FROM, UNTIL))


def test_a_recorder_that_keeps_up_says_nothing(drive, tmp_path, cli):
    said, dropped = through_a_pipe(drive, tmp_path / "again.mcap", (0.0, 0.0))
    assert (said, dropped, open_session(tmp_path / "again.mcap").holes()) == ("", 0, ())
    assert cli("info", tmp_path / "again.mcap").err == ""


def test_the_recorder_says_how_many_and_where_and_a_drive_is_cut_there(holed):
    path, said, dropped = holed
    assert dropped > 100
    ((first, last),) = open_session(path).holes()
    start_ns = open_session(path).info().start_ns
    assert FROM < (first - start_ns) / NS < UNTIL
    assert (last - start_ns) / NS == pytest.approx(UNTIL, abs=0.05)
    assert said.startswith(f"{dropped} records were dropped within ")
    watch = Watch()
    _, run = load_drive(path, "command", watch)
    ((first, last),) = pauses(run)
    ((hole_ns, end_ns),) = open_session(path).holes()
    assert last - first >= (end_ns - hole_ns) / NS
    assert f"{path.name}: {said}" in watch.warnings


def test_info_plot_and_catalogue_show_it(holed, cli):
    path = holed[0]
    assert f"warning: {holed[1]}" in cli("info", path).err
    assert run_cli(["plot", str(path)]) == 0
    assert "records were dropped within" in path.with_suffix(".html").read_text()
    assert "records dropped within" in cli("sessions", "--folder", path.parent).out


def test_a_hole_of_a_tick_is_a_pause_too(drive, tmp_path):
    whole = open_session(drive)
    middle = whole.info().start_ns + 10 * NS
    out = tmp_path / "short.mcap"
    given = {"metadata": whole.info().metadata, "attachments": {}, "start_ns": 0}
    recording = Recording({"path": out, "car": "car1", **given})
    for batch in ticks(whole):
        if not middle <= batch[0].log_time_ns < middle + NS // 50:
            for record in batch:
                recording.take(record)
    assert recording.finish("end of the run")
    ((first, last),) = pauses(read_run(open_session(out)))
    assert 0.3 <= last - first < 0.4
