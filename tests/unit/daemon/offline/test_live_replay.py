"""A drive with live parameters: what the car does, and a replay."""

from math import nan

import numpy as np
import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.car_model.path.path import locate
from steerd.daemon.analysis.gap_closed_loop import compare_lane
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session
from tests.replays import count_differences_without

pytestmark = pytest.mark.slow
OPTIONS = RunOptions(
    "", path="figure8", speed=1.5, simulated=True, auto_arm=True, duration_s=25.0, port="virtual"
)
CHANGES = [
    (6.0, {"speed": 0.75}), (10.0, {"offset": 0.1, "gain": 1.3}), (11.0, {"speed": 3.0}),
    (11.0, {"speed": 3.0, "offset": -0.1}), (18.0, {"speed": 1.25, "offset": -0.05}),
]  # fmt: skip
"""Seconds of the run, and what is requested then."""


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A drive in virtual time with an operator's changes."""
    path = tmp_path_factory.mktemp("live") / "drive.mcap"
    record_virtual(make_plan(OPTIONS), path, ask_on_the_way)
    return open_session(path)


def ask_on_the_way(run):
    for seq, (t_s, values) in enumerate(CHANGES):
        while run.t_ns < t_s * 1e9:
            run.step()
        wanted = {"speed": nan, "offset": nan, "gain": nan, **values}
        request = m.ParameterRequest(
            m.make_header(run.t_ns, m.BODY), run.core.loop.lease.boot_id, 7, seq, *wanted.values(),
            "desk",
        )  # fmt: skip
        assert run.core.on_request(topics.SET_PARAMETERS.name, encode(request), run.t_ns)
    while not (run.core.loop.ran and run.core.loop.parked):
        run.step()


def running(session, start, end):
    """The states of the running car between these times [s]."""
    table = session.columns(m.StateMessage)
    t = (table["mono_ns"] - table["mono_ns"][0]) * 1e-9
    kept = (table["mode"] == SupervisorState.RUNNING) & (t > start) & (t < end)
    return {name: column[kept] for name, column in table.items()}


def test_the_car_does_as_asked_and_is_never_stopped_for_it(session):
    assert SupervisorState.FAULT_STOP not in session.columns(m.StateMessage)["mode"]
    assert running(session, 8.0, 10.0)["speed"] == pytest.approx(0.75, abs=0.02)
    assert running(session, 4.0, 5.9)["speed"].max() > 1.4
    assert running(session, 20.0, 24.0)["speed"].max() == pytest.approx(1.25, abs=0.03)
    assert running(session, 6.0, 24.0)["speed_ref"].max() <= 1.5
    assert np.abs(running(session, 14.0, 18.0)["e1"]).max() < 0.01, "of the shifted lane"


def test_such_a_drive_is_no_measure_of_a_simulated_one(session):
    with pytest.raises(SteerdError, match="live parameters were changed"):
        compare_lane(session, load_car(default_car_path()), {})


def test_the_lane_lies_beside_the_path(session):
    path = make_plan(OPTIONS).path
    for start, end, offset in ((14.0, 18.0, 0.1), (21.5, 24.0, -0.05)):
        states = running(session, start, end)
        places = np.column_stack([states[name][::10] for name in ("x", "y", "yaw")])
        beside = [locate(path, *place).e1 for place in places.tolist()]
        assert beside == pytest.approx([offset] * len(places), abs=0.02)
        assert len(places) > 20


def test_a_replay_gives_every_order_again_and_without_the_requests_others(session):
    assert count_differences_without(session, "cmd/parameters", ticks=2000) > 1000
