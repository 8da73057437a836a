"""`steerd learn` and `run --learn`: what a drive teaches while it lasts."""

import json
import re

import pytest

from steerd.daemon.cli.main import dispatch
from steerd.steer_bus.session_read import open_session

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A figure-eight of 34 s in virtual time; the simulated servo horn is bumped from the start."""
    path = tmp_path_factory.mktemp("learn") / "eight.mcap"
    line = f"run --sim --fast --learn --adapt --duration 38 --speed 1.7 --seed 3 --record {path}"
    assert dispatch([*line.split(), "--effect", "steer_bias=0.02"]) == 0
    return path


def test_a_drive_teaches_the_car(driven, capsys):
    assert dispatch(["learn", str(driven)]) == 0
    out = capsys.readouterr().out
    assert "no change of the car" in out
    bias = re.search(r"steer_bias +([-+.\d]+) ± ([.\d]+) rad", out)
    assert float(bias[1]) == pytest.approx(0.02, abs=max(4.0 * float(bias[2]), 0.001))
    assert max(map(len, out.splitlines())) <= 80
    reported = re.search(r"in the session: (\d+) of (\d+) the same to the byte", out)
    assert reported[1] == reported[2]
    assert int(reported[2]) >= 30


def test_the_lane_keeper_follows_what_was_learnt_and_a_replay_gives_it_again(driven, capsys):
    said = [r.decode() for r in open_session(driven).messages("/steerd/car1/design")]
    assert said[0].text == "the car is being learnt"
    taken = [d for d in said if d.number]
    assert taken[-1].steer_bias == pytest.approx(0.02, abs=0.004)
    assert taken[-1].steer_gain == 1.0, "what is not sure stays the file's"
    assert dispatch(["replay", str(driven)]) == 0
    assert "all equal the recorded ones" in capsys.readouterr().out


def test_a_drive_teaches_the_same_again_to_the_byte(driven, capsys):
    found = []
    for _ in range(2):
        assert dispatch(["learn", str(driven), "--json"]) == 0
        found.append(capsys.readouterr().out)
    assert found[0] == found[1]
    values = json.loads(found[0])
    assert values["schema"] == "steerd.learn/1"
    assert values["gap"] == {"verdict": "none", "since_s": None, "causes": [], "changes": []}
    assert values["reports"]["count"] >= 30
    assert values["model"]["steer_bias"]["identifiable"]
