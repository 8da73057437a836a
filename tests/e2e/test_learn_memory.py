"""A drive whose learner began with an earlier drive's numbers: its recording gives the same."""

import json

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.analysis.learning import learn_session, wiring_of_session
from steerd.daemon.assembly.session_meta import make_metadata
from steerd.daemon.cli.main import dispatch
from steerd.daemon.ipc.pipe_records import PipeRecord, pack_record
from steerd.daemon.learning.feed import NEEDED
from steerd.daemon.learning.kept import METADATA
from steerd.daemon.learning.reported import reported_values
from steerd.daemon.process.learner import LearnerLoop, make_learner_feed
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from steerd.steer_bus.topics import find_topic

pytestmark = pytest.mark.slow
MEMORY = json.dumps({"days": 1.0, "values": {"speed_gain": [1.0007, 0.0004]}})


class Reports:
    """Where a learner's reports go."""

    def __init__(self):
        self.packed = []

    def write(self, packed, _t_ns):
        self.packed += packed


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A drive of which the session says that its learner had a memory."""

    def with_memory(*args, **keywords):
        return make_metadata(*args, **keywords) | {METADATA: {"memory": MEMORY}}

    path = tmp_path_factory.mktemp("memory") / "eight.mcap"
    line = f"run --sim --fast --duration 30 --speed 1.7 --seed 3 --record {path}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("steerd.daemon.offline.fast.make_metadata", with_memory)
        assert dispatch(line.split()) == 0
    return path


def live_reports(session, memory):
    """What the learner process reports of the drive."""
    wiring, path = wiring_of_session(session), default_car_path()
    job = {"epoch_ns": wiring.epoch_ns, "car": path.read_text(), "path": str(path),
           "erpm_gain": wiring.erpm_gain, "erpm_offset": wiring.erpm_offset,
           "memory": memory}  # fmt: skip
    reports = Reports()
    loop = LearnerLoop(make_learner_feed(job), [reports])
    for record in session.messages():
        topic = find_topic(record.topic)
        if topic in NEEDED:
            packed = PipeRecord(
                topic, record.sequence, record.log_ns, record.publish_ns, record.data
            )
            loop.take(bytearray(pack_record(packed)))
    return reports.packed


def test_a_recording_gives_the_same_reports_from_the_same_memory(driven):
    seen = []
    found = learn_session(driven, see=seen.append)
    first = {value.name: value for value in reported_values(seen[0])}
    assert seen[0].verdict == "learning"
    assert first["speed_gain"].value == 1.0007, "the first report begins with the memory"
    assert seen[-1].verdict == "none"
    cold = []
    learn_session(driven, default_car_path(), see=cold.append)
    assert reported_values(cold[0]) == []
    assert seen[-1].speed_gain_sd < cold[-1].speed_gain_sd
    assert found.reports == len(cold)


def test_the_process_reports_the_same_bytes_as_the_recording(driven):
    session, made = open_session(driven), []
    learn_session(driven, see=made.append)
    live = live_reports(session, MEMORY)
    assert len(live) == len(made)
    assert all(encode(report) in packed for report, packed in zip(made, live, strict=True))
