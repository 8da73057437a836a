"""Remembered gains: digit by digit those that were computed, checked all the same."""

import json
import subprocess
import sys

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path_spec import parse_path
from steerd.controller.build import compute_table, make_controller
from steerd.controller.config import ControllerConfig
from steerd.controller.design import DesignRefused
from steerd.controller.loop_model import Timing
from steerd.daemon.assembly import design_cache
from steerd.daemon.assembly.design_cache import designs_folder, digest_design, recall_table

CASE = (DEFAULT_CAR, ControllerConfig(), Timing(100.0, 0.01, 0.05), 1.5)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache folder of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return designs_folder()


def test_gains_come_back_digit_by_digit(monkeypatch, folder):
    first = recall_table(*CASE)
    assert first == compute_table(*CASE)
    monkeypatch.setattr(design_cache, "compute_table", lambda *case: pytest.fail("computed"))
    assert recall_table(*CASE) == first
    assert len(list(folder.iterdir())) == 1


def test_another_car_speed_or_rate_has_gains_of_its_own():
    car, config, timing, speed = CASE
    cases = [
        CASE,
        (car._replace(mass=3.8), config, timing, speed),
        (car, ControllerConfig(damping_min=0.2), timing, speed),
        (car, config, timing._replace(delay_s=0.02), speed),
        (car, config, timing, 1.6),
    ]
    assert len({digest_design(*case) for case in cases}) == len(cases)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "[0.1, 0.25, []]", "[0.1, 0.25, [[1.0, 2.0]]]", '[0.1, "x", [[1.0]]]', "[NaN, 1]",
     "[0.1, 0.25, [[NaN, 1, 1, 1, 1, 1, 1, 1, 1, 1]]]"],
)  # fmt: skip
def test_a_damaged_file_is_computed_again(folder, text):
    whole = recall_table(*CASE)
    (file,) = folder.iterdir()
    file.write_text(text)
    assert recall_table(*CASE) == whole
    assert json.loads(file.read_text())[0] == whole.speed_min


def test_remembered_gains_that_do_not_hold_the_car_are_refused(folder):
    path = parse_path("circle:radius=3")
    made = make_controller(DEFAULT_CAR, path, ControllerConfig(), 100.0, design=recall_table)
    (file,) = folder.iterdir()
    speed_min, spacing, rows = json.loads(file.read_text())
    wild = [[-row[0], *row[1:]] for row in rows]
    file.write_text(json.dumps([speed_min, spacing, wild]))
    with pytest.raises(DesignRefused, match="unstable"):
        make_controller(DEFAULT_CAR, path, ControllerConfig(), 100.0, design=recall_table)
    assert made.table.rows[0][0] == rows[0][0]


def test_a_folder_that_cannot_be_written_costs_nothing_but_time(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert recall_table(*CASE) == compute_table(*CASE)


def test_the_second_start_does_without_python_control():
    code = (
        "import sys\n"
        "from steerd.daemon.assembly.build import make_plan\n"
        "from steerd.daemon.settings.run_options import RunOptions\n"
        "make_plan(RunOptions('', path='circle:radius=3', simulated=True)).controller\n"
        "print(*{'control', 'matplotlib', 'torch'} & set(sys.modules))\n"
    )
    argv = [sys.executable, "-c", code]
    first, second = (
        subprocess.run(argv, capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    )
    assert "control" in first
    assert second == []
