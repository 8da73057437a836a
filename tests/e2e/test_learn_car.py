"""What README promises of learning: a car that the controller does not know, and what it gains."""

import re

import pytest

from steerd.daemon.cli.main import run_cli

pytestmark = pytest.mark.slow


def test_the_lane_error_of_an_unknown_car_falls_to_millimetres(tmp_path, capsys):
    def go(line):
        assert run_cli(line.format(folder=tmp_path).split()) == 0
        return capsys.readouterr().out

    def drive(*more):
        line = "run --sim --fast --sim-car hidden:4 --speed 2 --duration 12 --record"
        said = go(" ".join([line, f"{{folder}}/drive{len(more)}.mcap", *more]))
        return float(re.search(r"lateral error RMS ([\d.]+) mm", said)[1])

    before = drive()
    go("collect --sim --fast --sim-car hidden:4 --plan mixed --record {folder}/mixed.mcap")
    found = go("identify {folder}/mixed.mcap --wheelbase 0.3302 -o {folder}/car.toml")
    assert re.search(r"next steerd run --sim --fast .*--sim-car hidden:4", " ".join(found.split()))
    after = drive("--car", "{folder}/car.toml")
    assert before > 20.0 > 3.0 > after
