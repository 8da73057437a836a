"""`steerd learn` and `run --learn`: what a drive teaches while it lasts."""

import json
import re

import pytest

from steerd.daemon.cli.main import dispatch

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A figure-eight of 34 s in virtual time; the simulated servo horn is bumped from the start."""
    path = tmp_path_factory.mktemp("learn") / "eight.mcap"
    line = f"run --sim --fast --learn --duration 34 --speed 1.7 --seed 3 --record {path}"
    assert dispatch([*line.split(), "--effect", "steer_bias=0.02"]) == 0
    return path


def test_a_drive_teaches_the_car(driven, capsys):
    assert dispatch(["learn", str(driven)]) == 0
    out = capsys.readouterr().out
    assert "no change of the car" in out
    bias = re.search(r"steer_bias +([-+.\d]+) ± ([.\d]+) rad", out)
    assert float(bias[1]) == pytest.approx(0.02, abs=max(4.0 * float(bias[2]), 0.001))
    assert max(map(len, out.splitlines())) <= 80
    reported, count = re.search(
        r"in the session: (\d+) of (\d+) the same to the byte", out
    ).groups()
    assert reported == count
    assert int(count) >= 30


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
