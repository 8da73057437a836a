"""The supervisor's values in a diagnostics message; other messages are refused."""

import pytest

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.diagnostics import read_diagnostics
from steerd.steer_bus.messages import BODY, make_header
from steerd.steer_bus.standard import DiagnosticArray, DiagnosticStatus, KeyValue


def make_array(name):
    values = (KeyValue("state", "READY"), KeyValue("waiting", "arm"))
    status = DiagnosticStatus(level=0, name=name, message="", hardware_id="", values=values)
    return DiagnosticArray(make_header(0, BODY), (status,))


def test_the_values_of_the_supervisor_are_read_by_key():
    assert read_diagnostics(make_array("steerd: supervisor")) == {
        "state": "READY",
        "waiting": "arm",
    }


def test_another_node_is_refused():
    with pytest.raises(SteerdError):
        read_diagnostics(make_array("lidar"))
