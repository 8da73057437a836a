"""Heartbeats to the bus and back: who must answer, how soon, and what does not count."""

from dataclasses import replace

import pytest

from steerd.daemon.process.remote_path import BEAT_NS, RemotePath
from steerd.steer_bus.codec import encode

BOOT_ID, HOLDER, MS = 815, 42, 1_000_000
LIMIT_S = 1.0


def make_path(holder: int = 0) -> RemotePath:
    """A path whose first heartbeat has come back from the gateway at time 0."""
    path = RemotePath(BOOT_ID, holder)
    beat = path.make_beat(0, 0)
    path.take(encode(replace(beat, mono_ns=1)), 1)
    return path


def beat_at(path: RemotePath, t_ns: int, lease_id: int = 0):
    return replace(path.make_beat(t_ns, 0), lease_id=lease_id)


def test_heartbeats_leave_twenty_times_a_second():
    path = RemotePath(BOOT_ID)
    sent = [t for t in range(0, 1000 * MS, 10 * MS) if path.make_beat(t, 0) is not None]
    assert sent == list(range(0, 1000 * MS, BEAT_NS))


def test_a_gateway_that_has_never_answered_is_still_starting():
    assert not RemotePath(BOOT_ID).is_silent(False, LIMIT_S, 60_000 * MS)


@pytest.mark.parametrize(("t_ms", "silent"), [(1000, False), (1001, True)])
def test_a_gateway_that_has_answered_and_falls_silent_is_found(t_ms, silent):
    assert make_path().is_silent(False, LIMIT_S, t_ms * MS + 1) is silent


def test_the_newest_heartbeat_counts_from_when_it_left():
    path = make_path()
    for t_ms in range(50, 2000, 50):
        beat = beat_at(path, t_ms * MS)
        path.take(encode(beat), (t_ms + 30) * MS)
        path.take(encode(replace(beat, mono_ns=5)), (t_ms + 31) * MS)
        assert not path.is_silent(False, LIMIT_S, (t_ms + 40) * MS)
    assert not path.is_silent(False, LIMIT_S, 2950 * MS)
    assert path.is_silent(False, LIMIT_S, 2951 * MS)


def test_whoever_takes_the_lease_over_the_bus_has_to_answer_and_has_time_for_it():
    path = make_path(HOLDER)
    assert not path.is_silent(True, LIMIT_S, 5000 * MS)
    for t_ms in range(5050, 6050, 50):
        path.take(encode(beat_at(path, t_ms * MS)), t_ms * MS)  # the gateway's answers
        assert not path.is_silent(True, LIMIT_S, t_ms * MS)
    assert path.is_silent(True, LIMIT_S, 6001 * MS)
    path.take(encode(beat_at(path, 6050 * MS, HOLDER)), 6080 * MS)
    assert not path.is_silent(True, LIMIT_S, 7050 * MS)
    assert path.is_silent(True, LIMIT_S, 7051 * MS)
    assert not path.is_silent(False, LIMIT_S, 7052 * MS), "a lease that has run out is W25's"


@pytest.mark.parametrize(
    "wrong", [{"boot_id": 1}, {"lease_id": 7}, {"mono_ns": 500 * MS + 1}, {"mono_ns": -5}]
)
def test_another_runs_heartbeat_or_one_from_the_future_is_none(wrong):
    path = make_path()
    path.take(encode(replace(beat_at(path, 500 * MS), **wrong)), 500 * MS)
    assert path.is_silent(False, LIMIT_S, 1002 * MS)


@pytest.mark.parametrize("data", [b"", b"\0" * 7, b"\xff" * 300])
def test_garbage_is_none(data):
    path = make_path()
    path.take(data, 500 * MS)
    assert path.is_silent(False, LIMIT_S, 1002 * MS)
