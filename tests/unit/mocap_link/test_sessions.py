"""A mocap room with faults over datagrams: each ends in its reason, and no pose lies far off."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from math import hypot, remainder, tau
from typing import Any

import pytest

from steerd.car_model.state import ORIGIN
from steerd.mocap_link import natnet
from steerd.mocap_link.frame import FrameConfig
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import NatNetSource
from steerd.mocap_link.source import ClockKind, Pose, SourceState
from steerd.sim_hw.mocap.cameras import Bystander, MocapConfig
from steerd.sim_hw.mocap.network import FOREIGN
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World, WorldConfig
from steerd.vesc_link.commands import SetErpm, SetServoPos
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.packets import encode_command

MS = 1_000_000
SECOND = 1000 * MS
SERVER, STRANGER = "10.0.0.1", "10.0.0.66"
FRAME = FrameConfig(up="y", body_forward="+z", marker_rear_x=0.2, cog_ahead_of_rear=0.17,
                    mount_yaw=0.05)  # fmt: skip
SPEED, HEIGHT = 1.0, 0.12
QUIET = MocapConfig(
    frame=FRAME, height=HEIGHT, position_noise=0.0, yaw_noise=0.0, tilt_noise=0.0, jitter_ns=0,
    bystanders=(Bystander("b2", 2, (3.0, 1.0, 0.0)),), clock_hz=3_312_787,
)  # fmt: skip


class Room:
    """A server, a car in a bend, a network and a source in one virtual time."""

    def __init__(self, *faults: Fault, follow: str = "car", source: Any = None, **mocap: Any):
        config = WorldConfig(mocap=replace(QUIET, **mocap), keep_bytes=False, start=START)
        self.world = World(config, faults)
        self.world.vesc.motor.config = replace(self.world.vesc.motor.config, timeout_ms=0)
        for order in (SetErpm(4614.0 * SPEED), SetServoPos(0.35)):
            self.world.serial_write(0, encode_frame(encode_command(order)))
        self.source = source or NatNetSource(follow, SERVER, IngestConfig(frame=FRAME))
        self.source.ingest.wheel_speed = SPEED
        self.now, self.deaf, self.sent = 0, False, list[natnet.Message]()
        self.samples: list[Pose] = []
        self.off: dict[int, tuple[float, float]] = {}

    def run(self, seconds: float) -> list[Pose]:
        """Advance in steps of 5 ms; return the new samples."""
        first = len(self.samples)
        for _ in range(round(seconds * 200)):
            self.step()
        return self.samples[first:]

    def step(self) -> None:
        for datagram in self.source.on_timer(self.now):
            self.sent.append(natnet.decode(datagram, (4, 1)))
            self.world.mocap_write(self.now, datagram)
        self.now += 5 * MS
        for m in self.world.mocap_read(self.now):
            which: Any = "data" if natnet.peek_id(m.data) == natnet.FRAME_ID else "command"
            sender = STRANGER if m.channel == FOREIGN else SERVER
            if which == "command" or not self.deaf:
                self.take(self.source.on_datagram(m.data, m.t_ns, sender, which))

    def take(self, samples: list[Pose]) -> None:
        """Keep samples, and how far each lies from where the car was at its time [m, rad]."""
        for sample in samples:
            true = self.world.car.state_at(sample.t_valid_ns)
            turned = abs(remainder(sample.yaw - true.yaw, tau))
            self.off[id(sample)] = hypot(sample.x - true.x, sample.y - true.y), turned
        self.samples += samples

    @property
    def state(self) -> SourceState:
        return self.source.status().state

    def error(self, sample: Pose) -> float:
        return self.off[id(sample)][0]

    def count(self, name: str) -> int:
        return sum(sample.rejected == name for sample in self.samples)

    def assert_no_jump(self, samples: Iterable[Pose], most: float = 0.03) -> None:
        assert all(self.error(s) < most for s in samples if s.rejected is None)


START = ORIGIN._replace(x=1.0, y=1.0, speed=SPEED)


def begin(*faults: Fault) -> Room:
    """A room that has been up and well for a second."""
    room = Room(*faults)
    room.run(1.0)
    assert room.state is SourceState.OK
    room.samples.clear()
    return room


@pytest.mark.parametrize("version", [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2)])
@pytest.mark.parametrize(("skew_ppm", "follow"), [(-40.0, "car"), (40.0, "id:1")])
def test_a_good_drive(version, skew_ppm, follow):
    room = Room(version=version, skew_ppm=skew_ppm, follow=follow)
    late = [s for s in room.run(5.0) if s.t_arrival_ns > SECOND]
    assert len(late) > 390
    for s in late:
        assert (s.rejected, s.clock) == (None, ClockKind.ECHO)
        assert room.error(s) < 5e-4  # half a millisecond of time at 1 m/s
        assert room.off[id(s)][1] < 1e-3
        assert s.height == pytest.approx(HEIGHT, abs=1e-6)
    status = room.source.status()
    assert (status.state, status.rate_hz, status.expected_rate_hz) == (SourceState.OK, 100.0, 100.0)
    assert status.bodies == ("car", "b2")


def test_2_9_is_timed_one_way():
    room = Room(version=(2, 9))
    late = [s for s in room.run(4.0) if s.t_arrival_ns > 3 * SECOND]
    assert room.state is SourceState.OK
    assert {s.clock for s in late} == {ClockKind.HULL}
    room.assert_no_jump(late, 2e-3)  # 5.5 ms real delay against the 6 ms that are assumed


@pytest.mark.parametrize(("fault", "reason"), [
    ("invalid", "invalid"), ("M9", "zero_pose"), ("M8", "not_finite"), ("M10", "units"),
    ("mean_error_ramp", "mean_error"), ("body_removed", ""), ("M6", "yaw_jump"), ("M4", "jump"),
    ("M11", "jump"), ("M12", "jump"), ("edit_mode", "not_live"),
])  # fmt: skip
def test_a_fault_ends_in_its_reason_and_in_lost_and_its_end_in_ok(fault, reason):
    room = begin(Fault(fault, SECOND, 1200 * MS))
    room.run(0.1)
    wrong = [s.rejected for s in room.samples if s.t_valid_ns > SECOND]
    assert wrong[:4] == [reason] * 4 * bool(reason)
    assert room.state is SourceState.STALE
    room.run(0.1)
    assert room.state is SourceState.LOST
    assert all(s.rejected is not None for s in room.samples if s.t_valid_ns > SECOND)
    room.run(0.2)
    assert room.state is SourceState.OK
    room.assert_no_jump(room.samples)


@pytest.mark.parametrize(
    "fault", ["M16", "M17", "M18", "M19", "M20", "M22", "quaternion_sign", "model_change"]
)
def test_what_is_no_fault_of_the_pose_loses_none(fault):
    """Loss, gaps, doubles, noise and strangers between the frames."""
    room = begin(Fault(fault, SECOND))
    states = set()
    for _ in range(200):
        room.run(0.01)
        states.add(room.state)
    assert SourceState.LOST not in states
    assert room.state is SourceState.OK
    assert {s.rejected for s in room.samples} <= {None, "duplicate"}
    room.assert_no_jump(room.samples, 1e-3)


@pytest.mark.parametrize("multicast", [True, False])
def test_server_restart_with_a_new_epoch(multicast):
    room = Room(Fault("M1", 2 * SECOND, 5 * SECOND), Fault("server_restart", 5 * SECOND),
                multicast=multicast)  # fmt: skip
    room.run(5.0)
    assert room.state is SourceState.LOST
    assert not room.source.connected
    room.samples.clear()
    room.run(6.0)  # the backoff is 5 s at most
    assert room.state is SourceState.LOST, "3 m further on: only a stopped car is taken in"
    assert room.count("relocated")
    room.source.ingest.stationary = True
    room.run(2.0)
    assert room.state is SourceState.OK
    recovered = [s for s in room.samples if s.t_arrival_ns > room.now - SECOND]
    assert all(s.rejected is None and s.clock is ClockKind.ECHO for s in recovered)
    room.assert_no_jump(room.samples)


@pytest.mark.parametrize("step_ms", [None, -1000, -60, 60, 1000, 3 * 10**9])
def test_a_server_clock_that_steps_or_begins_anew_is_learnt_anew(step_ms):
    stepped = Fault("M21", SECOND, clock_step_ns=step_ms * MS) if step_ms else None
    room = begin(stepped or Fault("server_restart", SECOND))
    room.run(0.2)
    assert {s.clock for s in room.samples[-5:]} <= {ClockKind.ARRIVAL, ClockKind.ECHO}
    room.run(2.0)
    assert room.state is SourceState.OK
    assert room.samples[-1].clock is ClockKind.ECHO
    assert room.error(room.samples[-1]) < 1e-3
    room.assert_no_jump(room.samples)


def others(*named: tuple[str, int]) -> dict[str, Any]:
    return {"bystanders": tuple(Bystander(*each, (3.0, 1.0, 0.0)) for each in named)}


@pytest.mark.parametrize(("given", "deaf", "refused", "words"), [
    ({"follow": "cra"}, False, False, ("'cra'", "car, b2")),
    ({"multicast": True}, True, False, ("wrong interface",)),
    ({"version": (2, 7)}, False, True, ("NatNet 2.7",)),
    (others(("b2", 1)), True, True, ("share streaming id 1",)),
    (others(("car", 2)), False, True, ("named 'car'",)),
], ids=["unknown body", "answers without frames", "another age", "one id twice",
        "one name twice"])  # fmt: skip
def test_what_keeps_poses_away_is_explained(given, deaf, refused, words):
    room = Room(**given)
    room.deaf = deaf
    samples = room.run(1.5)
    status = room.source.status()
    assert all(word in status.detail for word in words)
    assert bool(status.refused) is refused
    assert not refused or all(s.rejected for s in samples[3:])


def test_connect_backs_off_and_echoes_and_keepalives_keep_their_pace():
    source, sent = NatNetSource("car", SERVER, IngestConfig()), []
    for k in range(4000):
        sent += [k * 0.005 for _ in source.on_timer(k * 5 * MS)]
    gaps = [round(b - a, 3) for a, b in pairwise(sent)]
    assert gaps[:5] == [0.5, 1.0, 2.0, 4.0, 5.0]
    room = Room()
    room.run(10.0)
    assert 20 + 19 <= sum(isinstance(m, natnet.EchoRequest) for m in room.sent) <= 20 + 21
    assert 10 <= room.sent.count(natnet.Bare.KEEP_ALIVE) <= 11
    assert room.sent.count(natnet.Bare.CONNECT) == 1
