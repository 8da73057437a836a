"""A recorder that stood still: the session says what it lacks, and nobody fits across it."""

import os
from itertools import groupby

import pytest

from steerd.daemon.analysis.drives import load_drive
from steerd.daemon.analysis.options import Watch
from steerd.daemon.cli.main import run_cli
from steerd.daemon.ipc import pipe_records
from steerd.daemon.process.recorder import Recording
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
    words = ["run", "--sim", "--fast", "--path", "figure8", "--speed", "1.5"]
    assert run_cli([*words, "--duration", "20", "--record", str(path)]) == 0
    return path


def pack_again(r):
    topic = find_topic(r.topic)
    return pipe_records.pack_record(
        pipe_records.PipeRecord(topic, r.sequence, r.log_ns, r.publish_ns, r.data)
    )


def record_again(whole, out, still=(0.0, 0.0), lost=(0.0, 0.0)):
    """Record a session again through the core's pipe, of which nobody reads for a while.

    What is sent while it is `lost` does not come at all.
    """
    session = open_session(whole)
    info = session.info()
    files = {a.name: a.data.decode() for a in session.attachments()}
    about = {"path": out, "car": "car1", "metadata": info.metadata, "start_ns": 0}
    recording = Recording({**about, "attachments": files})
    read_fd, write_fd = pipe_records.make_pipe()
    reader, writer = pipe_records.PipeReader(read_fd), pipe_records.PipeWriter(write_fd)
    for t_ns, batch in groupby(session.messages(), lambda r: r.log_ns):
        t = (t_ns - info.start_ns) / NS
        if not lost[0] <= t < lost[1]:
            writer.write([pack_again(record) for record in batch], t_ns)
        if not still[0] <= t < still[1]:
            for record in reader.take():
                recording.take(record)
    reader.close()
    os.close(write_fd)
    return recording.finish("end of the run"), writer.dropped


@pytest.fixture(scope="module")
def holed(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("holed") / "holed.mcap"
    return path, *record_again(drive, path, still=(FROM, UNTIL))


def test_a_recorder_that_keeps_up_says_nothing(drive, tmp_path, cli):
    said, dropped = record_again(drive, tmp_path / "again.mcap")
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
    ((before, after),) = pauses(load_drive(path, "command", watch)[1])
    assert after - before >= (last - first) / NS
    assert f"{path.name}: {said}" in watch.warnings


def test_info_plot_and_catalogue_show_it(holed, cli):
    path = holed[0]
    assert f"warning: {holed[1]}" in cli("info", path).err
    assert run_cli(["plot", str(path)]) == 0
    assert "records were dropped within" in path.with_suffix(".html").read_text()
    assert "records dropped within" in cli("sessions", "--folder", path.parent).out


def test_a_hole_of_a_tick_is_a_pause_too(drive, tmp_path):
    out = tmp_path / "short.mcap"
    said, _ = record_again(drive, out, lost=(10.0, 10.02))
    assert "records were dropped" in said
    ((first, last),) = pauses(read_run(open_session(out)))
    assert 0.3 <= last - first < 0.4
