"""What a drive teaches: offline, while it lasts, and from an earlier drive's numbers."""

import json
import re

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.analysis.learning import learn_session
from steerd.daemon.cli.main import dispatch
from steerd.daemon.learning.kept import METADATA
from steerd.daemon.learning.reported import reported_values
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus.messages import StateMessage
from steerd.steer_bus.session_read import open_session
from tests.e2e.conftest import rms
from tests.replays import copy_session

pytestmark = pytest.mark.slow


def test_the_lane_error_of_an_unknown_car_falls_to_millimetres(tmp_path, cli):
    car = "--sim --fast --sim-car hidden:4"

    def go(line):
        return cli(*line.format(folder=tmp_path).split()).out

    def drive(*more):
        line = f"run {car} --speed 2 --duration 12 --record"
        said = go(" ".join([line, f"{{folder}}/drive{len(more)}.mcap", *more]))
        return float(re.search(r"lateral error RMS ([\d.]+) mm", said)[1])

    before = drive()
    go(f"collect {car} --plan mixed --duration 30 --record {{folder}}/mixed.mcap")
    found = go("identify {folder}/mixed.mcap --wheelbase 0.3302 -o {folder}/car.toml")
    assert re.search(r"next steerd run --sim --fast .*--sim-car hidden:4", " ".join(found.split()))
    after = drive("--car", "{folder}/car.toml")
    assert before > 20.0 > 3.0 > after


# `steerd learn` and `run --learn`: what a drive teaches while it lasts.
@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A figure-eight of 34 s in virtual time; the simulated servo horn is bumped from the start."""
    path = tmp_path_factory.mktemp("learn") / "eight.mcap"
    line = f"run --sim --fast --learn --adapt --duration 38 --speed 1.7 --seed 3 --record {path}"
    assert dispatch([*line.split(), "--effect", "steer_bias=0.02"]) == 0
    return path


def test_a_drive_teaches_the_car_and_the_same_again_to_the_byte(learnt, cli):
    out = cli("learn", learnt).out
    assert "no change of the car" in out
    bias = re.search(r"steer_bias +([-+.\d]+) ± ([.\d]+) rad", out)
    assert float(bias[1]) == pytest.approx(0.02, abs=max(4.0 * float(bias[2]), 0.001))
    assert max(map(len, out.splitlines())) <= 80
    reported = re.search(r"in the session: (\d+) of (\d+) the same to the byte", out)
    assert reported[1] == reported[2]
    assert int(reported[2]) >= 30
    values = json.loads(cli("learn", learnt, "--json").out)
    reports = values["reports"]
    assert f"\n{reports['count']} reports, sha256 {reports['sha256'][:16]}\n" in out
    assert values["schema"] == "steerd.learn/1"
    assert values["gap"] == {"verdict": "none", "since_s": None, "causes": [], "changes": []}
    assert reports["count"] >= 30
    assert values["model"]["steer_bias"]["identifiable"]


def test_the_lane_keeper_follows_what_was_learnt_to_its_lane_and_so_does_a_replay(learnt, cli):
    said = [r.decode() for r in open_session(learnt).messages("/steerd/car1/design")]
    assert said[0].text == "the car is being learnt"
    taken = [d for d in said if d.number]
    assert taken[-1].steer_bias == pytest.approx(0.02, abs=0.004)
    assert taken[-1].steer_gain == 1.0, "what is not sure stays the file's"
    assert "all equal the recorded ones" in cli("replay", learnt).out
    session = open_session(learnt)
    designs = session.messages("/steerd/car1/design")
    taken_ns = next(r.log_ns for r in designs if r.decode().number)
    table = session.columns(StateMessage)
    assert SupervisorState.FAULT_STOP not in set(table["mode"])
    since = (table["log_ns"] - taken_ns) / 1e9
    before, after = (rms(table["e1"][np.abs(since - at) < 3.0]) for at in (-3, 8))
    assert after < 0.3 * before


# A drive whose learner began with an earlier drive's numbers: its recording gives the same.
MEMORY = json.dumps({"days": 1.0, "values": {"speed_gain": [1.0007, 0.0004]}})


def test_a_recording_gives_the_same_reports_from_the_same_memory(learnt, tmp_path):
    said = {METADATA: {"memory": MEMORY}}
    remembered = copy_session(learnt, tmp_path / "eight.mcap", metadata=said)
    seen = learn_session(remembered).reports
    first = {value.name: value for value in reported_values(seen[0])}
    assert seen[0].verdict == "learning"
    assert first["speed_gain"].value == 1.0007, "the first report begins with the memory"
    assert seen[-1].verdict == "none"
    cold = learn_session(remembered, default_car_path()).reports
    assert reported_values(cold[0]) == []
    assert seen[-1].speed_gain_sd < cold[-1].speed_gain_sd
    assert len(seen) == len(cold)
