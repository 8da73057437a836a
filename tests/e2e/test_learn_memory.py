"""A drive whose learner began with an earlier drive's numbers: its recording gives the same."""

import json

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.analysis.learning import learn_session
from steerd.daemon.assembly.session_meta import make_metadata
from steerd.daemon.cli.main import dispatch
from steerd.daemon.learning.kept import METADATA
from steerd.daemon.learning.reported import reported_values

pytestmark = pytest.mark.slow
MEMORY = json.dumps({"days": 1.0, "values": {"speed_gain": [1.0007, 0.0004]}})


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
