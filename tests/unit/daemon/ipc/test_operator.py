"""An operator's requests, and how a terminal finds the daemon that it asks."""

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc import operator
from steerd.daemon.ipc.operator import Operator, connect, read_lab, read_status
from steerd.steer_bus import topics
from steerd.steer_bus.bus import BusError
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.messages import BODY, OperatorRequest, RequestKind, make_header
from steerd.steer_bus.standard import DiagnosticArray, DiagnosticStatus, KeyValue
from steerd.steer_bus.topics import make_key
from tests.local_bus import LocalBus, LocalHub


class Clock:
    """Time that passes in sleeps alone."""

    def __init__(self, on_sleep=lambda: None):
        self.t_ns, self.on_sleep = 0, on_sleep

    def now_ns(self):
        return self.t_ns

    def realtime_ns(self):
        return self.t_ns

    def sleep_until_ns(self, deadline_ns):
        self.t_ns = deadline_ns
        self.on_sleep()


def test_requests_of_one_operator_rise_under_one_id():
    person = Operator(boot_id=7, lease_id=9, name="ada")
    kinds = (RequestKind.ARM, RequestKind.START, RequestKind.KEEPALIVE)
    sent = [decode(OperatorRequest, person.make_request(kind, 5)) for kind in kinds]
    assert [request.seq for request in sent] == [1, 2, 3]
    assert [RequestKind(request.kind) for request in sent] == list(kinds)
    assert {(r.boot_id, r.lease_id, r.operator) for r in sent} == {(7, 9, "ada")}
    assert {r.header for r in sent} == {make_header(5, BODY)}


def test_status_waits_for_the_first_diagnostics():
    hub = LocalHub()
    status = DiagnosticStatus(0, "steerd: supervisor", "", "car1", [KeyValue("state", "ARMED")])
    data = encode(DiagnosticArray(make_header(0, BODY), [status]))
    bus = LocalBus(hub)
    clock = Clock(lambda: bus.publish(make_key("car1", topics.DIAGNOSTICS), data))
    assert read_status(LocalBus(hub), "car1", clock)["state"] == "ARMED"
    assert clock.t_ns < 1e9


def test_a_car_that_says_nothing_is_unreachable_in_time():
    clock = Clock()
    with pytest.raises(SteerdError, match="no car 'car2' on the bus") as caught:
        read_status(LocalBus(LocalHub()), "car2", clock, timeout_s=0.5)
    assert caught.value.code is ExitCode.UNREACHABLE
    assert 0.5e9 <= clock.t_ns < 0.6e9


def test_a_folder_that_is_no_labs_is_invalid(tmp_path):
    with pytest.raises(SteerdError) as caught:
        read_lab(tmp_path)
    assert caught.value.code is ExitCode.INVALID


@pytest.mark.parametrize("endpoint", [None, "tcp/10.0.0.1:9"])
def test_where_none_answers_the_hint_says_what_to_start(monkeypatch, endpoint):
    asked = []

    def refuse(profile):
        asked.append(profile.endpoint)
        raise BusError("nobody there")

    monkeypatch.setattr(operator, "ZenohBus", refuse)
    with pytest.raises(SteerdError, match=r"no steerd answers: nobody there.*steerd run") as caught:
        connect(endpoint, None)
    assert caught.value.code is ExitCode.UNREACHABLE
    assert asked == [endpoint or operator.DEFAULT_ENDPOINT]
