"""What a run's learner begins with: the page beside its car file, if it is this car's."""

import json
import shutil
from dataclasses import replace

import pytest

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.learning.kept import DAY_NS, METADATA, format_kept
from steerd.daemon.process.learner import make_keeper, make_learner_feed
from steerd.daemon.process.learner_memory import learnt_page, make_learner_job, recall_learnt
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m


@pytest.fixture
def plan(tmp_path):
    """A run on a car, its file in a folder of its own."""
    path = tmp_path / "car.toml"
    shutil.copy(default_car_path(), path)
    options = RunOptions(car_file=str(path), port="/dev/null", learn=True)
    return make_plan(options)


@pytest.fixture
def report(make_report):
    return make_report("none")


def recalled(plan, now_ns):
    return recall_learnt(plan, plan.settings.file.path.with_name("next.mcap"), now_ns)


def kept(plan, report):
    """A drive's page, written as the learner process writes it."""
    memory = recalled(plan, m.stamp_ns(report.header))
    keeper = make_keeper(make_learner_job(plan, 0, memory))
    keeper.take(report)
    return memory


def test_what_one_run_keeps_the_next_begins_with(plan, report, capsys):
    first = kept(plan, report)
    assert (first.memory, dict(first.metadata), first.refused) == ("", {}, False)
    page = plan.settings.file.path.with_name("car.learnt.toml")
    assert first.page == str(page)
    second = recalled(plan, m.stamp_ns(report.header) + 2 * DAY_NS)
    assert json.loads(second.memory) == {"days": 2.0, "values": {"steer_gain": [0.98, 0.012]}}
    assert second.metadata[METADATA]["memory"] == second.memory
    assert second.metadata[METADATA]["file"] == "car.learnt.toml"
    assert capsys.readouterr().err == ""
    feed = make_learner_feed(json.loads(json.dumps(make_learner_job(plan, 0, second))))
    assert [each.name for each in feed.learner.remembered] == ["steer_gain"]
    assert plan.settings.file.path.read_text() == default_car_path().read_text()


def test_the_car_that_steerd_brings_is_kept_in_the_data_folder(plan, tmp_path, monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    own = make_plan(replace(plan.options, car_file=""))
    assert learnt_page(own) == tmp_path / "state" / "car1.learnt.toml"


@pytest.mark.parametrize("change", [{"learn": False}, {"simulated": True}])
def test_simulated_hardware_and_a_run_without_a_learner_keep_nothing(plan, report, change):
    kept(plan, report)
    other = make_plan(replace(plan.options, **change))
    memory = recalled(other, m.stamp_ns(report.header))
    assert (memory.page, memory.memory) == ("", "")
    assert make_keeper(make_learner_job(other, 0, memory)) is None


def test_an_edited_car_file_begins_anew_and_nothing_is_lost(plan, report, capsys):
    kept(plan, report)
    page, path = learnt_page(plan), plan.settings.file.path
    old, mass = page.read_text(), plan.settings.file.car.mass
    path.write_text(path.read_text().replace(f"mass = {mass}", "mass = 4.5"))
    edited = make_plan(plan.options)
    memory = kept(edited, report)
    assert memory.refused
    assert memory.memory == ""
    said = capsys.readouterr().err
    assert "the car file was edited since" in said
    assert said.count("\n") == 1
    (aside,) = set(page.parent.glob("car.learnt.*.toml")) - {page}
    assert aside.read_text() == old
    assert recalled(edited, m.stamp_ns(report.header)).memory != ""


def test_a_torn_page_is_named_and_left_out(plan, report, capsys):
    kept(plan, report)
    page = learnt_page(plan)
    page.write_bytes(page.read_bytes()[:-1])
    memory = recalled(plan, m.stamp_ns(report.header))
    assert (memory.memory, memory.refused) == ("", True)
    assert "car.learnt.toml is torn or was edited" in capsys.readouterr().err


def test_a_page_that_cannot_be_read_is_named_and_left_out(plan, capsys):
    learnt_page(plan).mkdir()
    memory = recalled(plan, 0)
    assert (memory.memory, memory.refused) == ("", True)
    assert "cannot be read" in capsys.readouterr().err


def test_a_page_keeps_the_time_of_its_drive(plan, report):
    memory = kept(plan, report)
    assert learnt_page(plan).read_text() == format_kept(memory.about, report)
