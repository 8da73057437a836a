"""What a session file says of its run: name, metadata, attachments."""

from dataclasses import replace
from pathlib import Path

import pytest

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.assembly.session_meta import (
    csv_file,
    default_session_path,
    make_attachments,
    make_metadata,
)
from steerd.daemon.settings.run_options import RunOptions, decode_options

OPTIONS = RunOptions(car_file="", path="line", speed=1.0, simulated=True)
NOON_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def plan():
    return make_plan(OPTIONS, design=False)


def test_a_session_is_named_by_date_car_and_run_in_the_services_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    path = default_session_path("car1", NOON_NS, 0x1_2345_6789)
    assert path == tmp_path / "sessions" / "2023-11-14T22-13-20Z_car1_23456789.mcap"


def test_without_a_service_it_is_in_the_users_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_session_path("car1", NOON_NS, 1).parent == tmp_path / "steerd" / "sessions"


def test_reproducible_metadata_say_nothing_of_the_machine(plan):
    plain = make_metadata(plan, 3, 4, leased=True)
    same = make_metadata(plan, 3, 4, leased=True, reproducible=True)
    lost = set(plain["steerd.session"]) - set(same["steerd.session"])
    assert {"host", "kernel"} <= lost <= {"host", "kernel", "git"}
    session = same["steerd.session"]
    assert (session["boot_id"], session["epoch_ns"], session["leased"]) == ("3", "4", "1")
    assert session["mode"] == "sim"
    assert decode_options(session["options"]) == plan.options


@pytest.mark.parametrize(
    ("spec", "file"),
    [("csv:lane.csv", "lane.csv"), ("csv:a/b.csv,closed", "a/b.csv"), ("circle:radius=2", None)],
)
def test_a_path_file_is_known_by_its_description(spec, file):
    assert csv_file(spec) == file


def test_car_file_and_path_file_are_attached_unchanged(plan, tmp_path: Path):
    lane = tmp_path / "lane.csv"
    lane.write_text("x,y\n0,0\n1,0\n")
    with_file = replace(plan, options=replace(plan.options, path=f"csv:{lane},closed"))
    assert make_attachments(plan) == {"car.toml": plan.settings.file.text}
    assert make_attachments(with_file)["path.csv"] == lane.read_text()
