"""The viewer's job: lane, car and car file as JSON; addresses accepted and refused."""

import json
from math import hypot

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.cli.main import run_cli
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.process.view_job import make_view_job, parse_view
from steerd.daemon.process.view_scene import make_parameters
from steerd.daemon.settings.run_options import RunOptions


def test_the_job_holds_the_lane_and_the_car_file_and_is_json():
    options = RunOptions(str(default_car_path()), path="circle:radius=2", view="9000")
    job = json.loads(json.dumps(make_view_job(make_plan(options))))
    assert (job["host"], job["port"], job["closed"]) == ("127.0.0.1", 9000, True)
    assert [hypot(x, y - 2.0) for x, y, _ in job["lane"]] == pytest.approx([2.0] * len(job["lane"]))
    assert 200 < len(job["lane"]) < 400  # 12.6 m in steps of about 5 cm
    assert make_parameters(job["parameters"])["car.lf"] == job["body"]["lf"]


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("8765", "127.0.0.1", 8765), ("localhost:1", "localhost", 1), ("[::1]:80", "::1", 80)],
)
def test_addresses(text, host, port):
    assert parse_view(text, insecure_lan=False) == (host, port)


@pytest.mark.parametrize("text", ["", "x", "0", "65536", "127.0.0.1:", "0.0.0.0:8765", "lab:8765"])
def test_invalid_and_public_addresses_are_refused(text):
    with pytest.raises(SteerdError):
        parse_view(text, insecure_lan=False)


def test_others_may_watch_with_insecure_lan():
    assert parse_view("0.0.0.0:8765", insecure_lan=True) == ("0.0.0.0", 8765)


def test_virtual_time_is_not_shown_live(capsys):
    assert run_cli(["run", "--sim", "--fast", "--view"]) == 2
    assert "steerd plot" in capsys.readouterr().err


def test_a_missing_package_is_one_line_with_its_remedy(capsys, monkeypatch):
    monkeypatch.setattr("steerd.daemon.process.view_job.find_spec", lambda name: None)
    assert run_cli(["run", "--sim", "--view"]) == 3
    said = capsys.readouterr().err
    assert "foxglove-sdk" in said
    assert "pip install" in said
    assert len(said.splitlines()) == 2
