"""`steerd identify --jobs` and `--dask`: the same answer from other processes."""

import json

import numpy as np
import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.daemon.cli.main import run_cli as main
from steerd.sysid.compiler.kernels import (
    HeldCommands,
    make_kernels,
    make_window_blocks,
    march,
    view_by_window,
)

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
MAP = """[columns]
t = "t"
x = "x"
y = "y"
yaw = "yaw"
steer_cmd = "steer"
speed_cmd = "speed"
[session]
car = "lab"
"""
SEARCH = ("--method", "paper", "--starts", "2", "--iterations", "2", "--held-out", "3")


@pytest.fixture
def session(tmp_path):
    """A drive of 20 s as an imported log."""
    t = 0.01 * np.arange(2000)
    commands = np.column_stack([0.2 * np.sin(1.3 * t + 0.1 * t * t), np.ones_like(t)])
    blocks = make_window_blocks(np.array([[0, len(t), 0]]), np.zeros(1))
    first = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    path = march(
        make_kernels(), np.array(DEFAULT_CAR), first, HeldCommands(commands, 0.01), blocks, len(t)
    )
    rows = np.column_stack([t, view_by_window(path, 1)[0, :-1, :3], commands])
    np.savetxt(
        tmp_path / "run.csv", rows, delimiter=",", header="t,x,y,yaw,steer,speed", comments=""
    )
    (tmp_path / "map.toml").write_text(MAP)
    out = tmp_path / "run.mcap"
    files = [str(tmp_path / "run.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(out)]
    assert main(["import", "csv", *files]) == 0
    return out


def _answer(session, *more):
    path = session.with_suffix(".json")
    code = main(["identify", str(session), *SEARCH, "--json", str(path), *more])
    return code, json.loads(path.read_text())


def test_processes_and_a_cluster_give_the_same_answer(session):
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    here = _answer(session)
    assert _answer(session, "--jobs", "2") == here
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        assert _answer(session, "--dask", cluster.scheduler_address) == here
