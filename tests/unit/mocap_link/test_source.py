"""Addresses and the source state machine."""

from dataclasses import replace

import pytest

from steerd.mocap_link.mocap_url import MocapUrl, parse_mocap_url
from steerd.mocap_link.source import MonitorConfig, MonitorState, SourceState, step_monitor

MS = 1_000_000
CONFIG = MonitorConfig()

GOOD = {
    "natnet://10.0.0.5/car": MocapUrl("natnet", "10.0.0.5", 1510, "car"),
    "natnet://h:99/id:42?up=y&unicast=1&interface=10.0.0.2": MocapUrl(
        "natnet", "h", 99, "id:42", up="y", unicast=True, interface="10.0.0.2"
    ),
    "natnet://h/My%20Car?unicast=0": MocapUrl("natnet", "h", 1510, "My Car", unicast=False),
    "vrpn://tracker.lab/car?up=z": MocapUrl("vrpn", "tracker.lab", 3883, "car", up="z"),
    "zenoh:lab/pose/car": MocapUrl("zenoh", key="lab/pose/car"),
}
BAD = {
    "": "expected natnet",
    "car": "expected natnet",
    "tcp://h/car": "expected natnet",
    "natnet:h/car": "expected natnet",
    "natnet:///car": "no host",
    "natnet://h": "no body",
    "natnet://h:port/car": "port must be",
    "natnet://h:99999/car": "port must be",
    "natnet://h/id:x": "not an id",
    "vrpn://h/id:4": "only NatNet",
    "vrpn://h/car?unicast=1": "unknown option",
    "natnet://h/car?up=x": "up must be y or z",
    "natnet://h/car?interface=": "no value",
    "natnet://h/car?speed=3": "known: interface, unicast, up",
    "zenoh:": "zenoh key",
    "zenoh:/a": "zenoh key",
}


@pytest.mark.parametrize("text", GOOD)
def test_addresses(text: str) -> None:
    assert parse_mocap_url(text) == GOOD[text]


@pytest.mark.parametrize("text", BAD)
def test_bad_addresses_say_what_is_wrong(text: str) -> None:
    with pytest.raises(ValueError, match=BAD[text]):
        parse_mocap_url(text)


def feed(s: MonitorState, t_ms: float, good: bool | None = None) -> MonitorState:
    return step_monitor(CONFIG, s, round(t_ms * MS), connected=True, clock_ready=True, good=good)


def bring_up() -> MonitorState:
    s = MonitorState()
    for i in range(10):
        s = feed(s, 10 * i, True)
    return s


def test_start_up() -> None:
    s = step_monitor(CONFIG, MonitorState(), 0, connected=False, clock_ready=False)
    assert s.state is SourceState.CONNECTING
    s = step_monitor(CONFIG, s, 0, connected=True, clock_ready=False)
    assert s.state is SourceState.SYNCING
    for i in range(30):
        s = step_monitor(CONFIG, s, i * 10 * MS, connected=True, clock_ready=False, good=True)
    assert s.state is SourceState.SYNCING  # plenty of frames, no clock
    assert feed(s, 300, True).state is SourceState.OK
    s = step_monitor(CONFIG, replace(s, good_run=0), 0, connected=False, clock_ready=False)
    assert s.state is SourceState.CONNECTING


def test_ok_needs_ten_good_frames_in_a_row() -> None:
    s = MonitorState()
    for i in range(9):
        s = feed(s, 10 * i, True)
    assert s.state is SourceState.SYNCING
    s = feed(s, 90, False)
    for i in range(10, 19):
        s = feed(s, 10 * i, True)
    assert s.state is SourceState.SYNCING
    assert feed(s, 190, True).state is SourceState.OK


def test_timing_of_stale_and_lost_is_exact() -> None:
    s = bring_up()
    assert s.state is SourceState.OK
    for ms, state in {120: "ok", 120.001: "stale", 240: "stale", 240.001: "lost"}.items():
        assert feed(s, ms).state == state  # the last good frame was at 90 ms
    assert feed(feed(s, 130), 131, True).state is SourceState.OK


def test_bad_frames_are_not_life() -> None:
    s = bring_up()
    for i in range(10, 30):
        s = feed(s, 10 * i, False)
    assert s.state is SourceState.LOST


def test_lost_ends_after_ten_good_frames() -> None:
    s = feed(bring_up(), 500)
    assert s.state is SourceState.LOST
    for i in range(9):
        s = feed(s, 500 + 10 * i, True)
        assert s.state is SourceState.LOST
    assert feed(s, 600, True).state is SourceState.OK


def test_lost_stays_lost_when_disconnected_or_without_clock() -> None:
    s = feed(bring_up(), 500)
    s = step_monitor(CONFIG, s, 600 * MS, connected=False, clock_ready=True)
    assert s.state is SourceState.LOST
    for i in range(20):
        t = (600 + 10 * i) * MS
        s = step_monitor(CONFIG, s, t, connected=True, clock_ready=False, good=True)
    assert s.state is SourceState.LOST
