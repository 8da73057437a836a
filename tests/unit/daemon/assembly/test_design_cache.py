"""Remembered gains: digit by digit those that were computed, checked all the same."""

import subprocess
import sys

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.controller.build import compute_table
from steerd.controller.config import ControllerConfig
from steerd.controller.loop_model import Timing
from steerd.daemon.assembly import design_cache
from steerd.daemon.assembly.design_cache import designs_folder, digest_design, recall_table
from steerd.sealed_file import CacheRefused

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
        CASE, (car._replace(mass=3.8), config, timing, speed), (car, config, timing, 1.6),
        (car, ControllerConfig(damping_min=0.2), timing, speed),
        (car, config, timing._replace(delay_s=0.02), speed),
    ]  # fmt: skip
    assert len({digest_design(*case) for case in cases}) == len(cases)


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_changed_gains_are_computed_again(folder, factor):
    whole = recall_table(*CASE)
    (file,) = folder.iterdir()
    text = file.read_text()
    gain = whole.rows[0][0]
    assert repr(gain) in text
    file.write_text(text.replace(repr(gain), repr(factor * gain)))
    with pytest.warns(CacheRefused, match="is damaged or was changed; it is made anew"):
        assert recall_table(*CASE) == whole
    assert file.read_text() == text


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
    first, second = (subprocess.check_output(argv, text=True).split() for _ in range(2))
    assert "control" in first
    assert second == []
