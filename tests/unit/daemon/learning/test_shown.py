"""Where people look: the dashboard, `steerd status`, and what the gateway answers."""

import io
import os
import socket

import pytest
from rich.console import Console

from steerd.daemon.ipc.operator import read_model
from steerd.daemon.ipc.pipe_records import PipeRecord, make_pipe, pack_record
from steerd.daemon.ipc.report_pipe import ReportPipe
from steerd.daemon.learning.feed import make_record
from steerd.daemon.process.gateway import Gateway, run_gateway
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import LAST_MODEL, make_key
from tests.local_bus import LocalBus, LocalHub


def shown(board):
    """The dashboard on a terminal of 80 columns."""
    screen = io.StringIO()
    Console(file=screen, width=80).print(board.render())
    return screen.getvalue()


def record(report):
    return PipeRecord(topics.MODEL, 0, 1, 1, encode(report))


def test_the_dashboard_says_what_is_learnt(make_report):
    board = Dashboard("car1")
    assert "gap" not in shown(board)
    assert board.take(record(make_report("none"))) is None
    assert "no change of the car" in shown(board)


def test_a_change_is_an_event_once(make_report, make_change):
    board = Dashboard("car1")
    board.take(record(make_report("none")))
    line = board.take(record(make_report("changed", make_change("changed"))))
    assert line is not None
    assert line.startswith("GAP")
    assert "something changed" in line
    assert board.take(record(make_report("changed", make_change("changed")))) is None
    named = make_report("named", make_change())
    reported = board.take(record(named))
    assert reported is not None
    assert "steer_bias +0.0213 ± 0.0021 rad, 97 %" in reported
    assert list(board.events) == [line, reported]


@pytest.fixture
def core_pipe():
    """A core's pipe that is closed, so that the gateway ends after one look."""
    read_fd, write_fd = make_pipe()
    yield read_fd, write_fd
    os.close(read_fd)


def test_the_gateway_publishes_reports_and_answers_with_the_last(make_report, core_pipe):
    hub, (read_fd, write_fd) = LocalHub(), core_pipe
    listener, gateway = LocalBus(hub), Gateway(LocalBus(hub), "car1", None)
    heard = listener.subscribe(make_key("car1", topics.MODEL), 8)
    assert read_model(listener, "car1") is None
    report_fd, report_end = make_pipe()
    report = make_report("none")
    os.write(report_end, pack_record(make_record(report, 0, 1)))
    os.write(write_fd, b"\0")  # wakes it; no whole record
    os.close(report_end)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    os.close(write_fd)
    run_gateway(gateway, read_fd, ours, ReportPipe(report_fd))
    ours.close()
    theirs.close()
    assert [sample.data for sample in heard.poll()] == [encode(report)]
    last = read_model(listener, "car1")
    assert last is not None
    assert encode(last) == encode(report)


def test_an_answer_of_another_version_is_none(make_report):
    hub = LocalHub()
    server, asker = LocalBus(hub), LocalBus(hub)
    server.serve(make_key("car1", LAST_MODEL), lambda _: b"\0\1\0\0short")
    assert read_model(asker, "car1") is None
