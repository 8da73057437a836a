"""What was learnt, on a screen and for programs."""

import json
import os

import pytest

from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord, make_pipe, pack_record
from steerd.daemon.learning import reported
from steerd.daemon.learning.feed import make_record
from steerd.daemon.learning.reported import encode_model, format_model, gap_text
from steerd.daemon.process.bus_operator import read_model
from steerd.daemon.process.gateway import Gateway, run_gateway
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import LAST_MODEL, make_key
from tests.local_bus import LocalBus, LocalHub
from tests.unit.daemon.terminal.test_terminal import printed


@pytest.mark.parametrize(("verdict", "words"), [
    ("named", "since 11:59:20: steer_bias +0.0213 ± 0.0021 rad, 97 %"),
    ("changed", "since 11:59:20: something changed, too early to say what"),
    ("unexplained", "since 11:59:20: something changed that no effect explains"),
    ("none", "no change of the car"), ("learning", "learning the car"),
])  # fmt: skip
def test_a_change_is_told_with_its_time_and_odds(make_report, make_change, verdict, words):
    changes = () if verdict in ("none", "learning") else (make_change(verdict),)
    assert gap_text(make_report(verdict, *changes)).replace("\u00a0", " ") == words


def test_the_screen_fits_80_columns_and_hides_what_is_not_identifiable(make_report, make_change):
    change = make_change(alternatives=("steer_gain", "mocap_yaw", "cornering_stiffness"))
    report = make_report("named", change)
    said = "; this drive cannot distinguish it from steer_gain, mocap_yaw, cornering_stiffness"
    assert gap_text(report).endswith(said)
    lines = format_model(report)
    assert max(map(len, lines)) <= 80
    assert "  steer_gain  0.980 ± 0.012" in lines
    assert "not identifiable here: inertia_z" in lines


def test_json_has_the_gap_and_the_model(make_report, make_change):
    report = make_report("named", make_change(alternatives=("mocap_yaw",)))
    values = json.loads(json.dumps(encode_model(report), allow_nan=False))
    gap = values["gap"]
    assert gap["verdict"] == "named"
    assert gap["since_s"] == pytest.approx(m.stamp_ns(report.header) * 1e-9 - 40.0)
    (cause,) = gap["causes"]
    assert (cause["effect"], cause["alternatives"]) == ("steer_bias", ["mocap_yaw"])
    assert cause["parameters"]["bias"]["value"] == pytest.approx(0.0213)
    gain, inertia = values["model"]["steer_gain"], values["model"]["inertia_z"]
    assert gain == {"value": 0.98, "sd": 0.012, "unit": "1", "identifiable": True}
    assert inertia == {"value": 0.046, "sd": None, "unit": "kg m^2", "identifiable": False}
    unnamed = encode_model(make_report("changed", make_change("changed")))
    assert json.loads(json.dumps(unnamed, allow_nan=False))["gap"]["causes"] == []


@pytest.mark.parametrize(("value", "sd", "shown"), [
    (0.02134, 0.0021, "0.0213 ± 0.0021 rad"), (12.3, 4.2, "12.3 ± 4.2 rad"),
    (123.4, 42.0, "123 ± 42 rad"), (0.5, float("nan"), "0.5 rad"),
])  # fmt: skip
def test_numbers_have_the_digits_of_their_error(value, sd, shown):
    text = reported.with_sd(reported.ReportedValue("bias", value, sd, "rad"))
    assert text.replace("\u00a0", " ") == shown


# Where people look: the dashboard, `steerd status`, and what the gateway answers.
def record(report):
    return PipeRecord(topics.MODEL, 0, 1, 1, encode(report))


def test_the_dashboard_says_what_is_learnt_and_a_change_once(make_report, make_change):
    board = Dashboard("car1")
    assert "gap" not in printed(board.render())
    assert board.take(record(make_report("none"))) is None
    assert "no change of the car" in printed(board.render())
    line = board.take(record(make_report("changed", make_change("changed"))))
    assert line is not None
    assert line.startswith("GAP")
    assert "something changed" in line
    assert board.take(record(make_report("changed", make_change("changed")))) is None
    named = board.take(record(make_report("named", make_change())))
    assert named is not None
    assert "steer_bias +0.0213 ± 0.0021 rad, 97 %" in named
    assert list(board.events) == [line, named]


def test_the_gateway_publishes_reports_and_answers_with_the_last(make_report, pipe, ends):
    hub, (read_fd, write_fd) = LocalHub(), pipe
    listener, gateway = LocalBus(hub), Gateway(LocalBus(hub), "car1", None)
    heard = listener.subscribe(make_key("car1", topics.MODEL), 8)
    assert read_model(listener, "car1") is None
    LocalBus(hub).serve(make_key("car2", LAST_MODEL), lambda _: b"\0\1\0\0short")
    assert read_model(listener, "car2") is None, "of another version"
    report_fd, report_end = make_pipe()
    report = make_report("none")
    os.write(report_end, pack_record(make_record(report, 0, 1)))
    os.write(write_fd, b"\0")  # wakes it; no whole record
    os.close(report_end)
    os.close(write_fd)
    run_gateway(gateway, PipeReader(read_fd), ends[0], PipeReader(report_fd))
    assert [sample.data for sample in heard.poll()] == [encode(report)]
    last = read_model(listener, "car1")
    assert last is not None
    assert encode(last) == encode(report)
