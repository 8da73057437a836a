"""`steerd identify --jobs`: the same answer from other processes."""

import json

import numpy as np
import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.cli.main import run_cli as main
from tests.csv_logs import STEP, import_log, make_rows

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
SEARCH = ("--method", "paper", "--starts", "2", "--iterations", "2", "--held-out", "3")


@pytest.fixture
def session(tmp_path):
    """A drive of 20 s as an imported log."""
    t = STEP * np.arange(2000)
    steer = 0.2 * np.sin(1.3 * t + 0.1 * t * t)
    first = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    return import_log(tmp_path, make_rows(DEFAULT_CAR, steer, np.ones_like(t), first))


def _answer(session, *more):
    path = session.with_suffix(".json")
    code = main(["identify", str(session), *SEARCH, "--json", str(path), *more])
    return code, json.loads(path.read_text())


def test_processes_give_the_same_answer(session):
    assert _answer(session, "--jobs", "2") == _answer(session)
