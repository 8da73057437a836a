"""`steerd collect` in real time, on a port as on a car."""

import numpy as np
import pytest

from steerd.steer_bus import messages as m
from steerd.steer_bus.session_read import open_session
from steerd.sysid.data.dataset import read_run

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]
PLAN = ("--plan", "steps", "--box", "14", "--duration", "4")


def test_a_car_on_a_port_drives_the_plan(undisturbed):
    """The session holds an exciting drive that identification can read."""

    def scenario(steerd, folder):
        port, url = steerd.sim(folder)
        record = folder / "drive.mcap"
        run = steerd("collect", "--listen", steerd.endpoint, "--record", record, *PLAN,
                     "--port", port, "--mocap", url)  # fmt: skip
        run.expect("READY")
        steerd("arm", "--connect", steerd.endpoint).expect("armed:")
        go = steerd("start", "--connect", steerd.endpoint)
        assert run.expect("RUNNING|FAULT")[0] == "RUNNING", run.text
        assert run.wait() == 0, run.text
        assert go.wait() == 0, go.text
        assert "end of the run" in run.text
        asked = open_session(record).columns(m.Actuation)
        driven = asked["mode"] == m.ActuationMode.SPEED
        assert np.ptp(asked["steer"][driven]) > 0.05
        run = read_run(open_session(record))
        assert run.duration > 2.5
        assert run.servo_frame == 0.02
        assert np.ptp(run.pose.values[:, 0]) > 1.0

    undisturbed(scenario)
