"""Faults of the catalogue do what they say, seen on the bytes that a host gets.

Those that stop a car are shown by their cells of the matrix (`tests/safety/trace.py`), those that
spoil a pose by the reason of its rejection (`tests/unit/mocap_link/test_sessions.py`).
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from steerd.car_model.state import ORIGIN
from steerd.mocap_link import natnet
from steerd.mocap_link.natnet_wire import MODEL_CHANGED, Frame, NatNetError
from steerd.sim_hw.mocap.cameras import Bystander, MocapConfig
from steerd.sim_hw.mocap.network import CLOSE, FOREIGN, Datagram
from steerd.sim_hw.plant import faults
from steerd.sim_hw.plant.faults import FAULTS, Fault, find_fault, make_condition
from steerd.sim_hw.world import World, WorldConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link.telemetry import Values

MS = 1_000_000
ON, OFF = 1000 * MS, 2000 * MS
VERSION = MocapConfig().version
BESIDE = MocapConfig(bystanders=(Bystander("box", 2, (3, 1, 0)),))
DRIVING = WorldConfig(start=ORIGIN._replace(speed=1.0), mocap=BESIDE)


# --- the catalogue
def test_catalogue_is_complete_and_each_entry_changes_the_fault_state():
    codes = [kind.code for kind in FAULTS if kind.code]
    assert codes == [f"M{n}" for n in range(1, 23)] + [f"V{n}" for n in range(1, 25)]
    for kind in FAULTS:
        condition = make_condition([Fault(kind.name)], 1 << 40)
        changed = (condition.vesc, condition.mocap) != (faults.HEALTHY_VESC, faults.HEALTHY_MOCAP)
        assert changed, kind.name
        assert (condition.vesc == faults.HEALTHY_VESC) == (kind.target == "mocap")


def test_windows_edges_sums_and_mistakes():
    fault = Fault("M4", 10, 20, jump=1.0)
    jumps = [make_condition([fault], t).mocap.jump for t in (9, 10, 19, 20)]
    assert jumps == [0.0, 1.0, 1.0, 0.0]
    assert fault.kind is find_fault("jump")
    assert make_condition([fault], 0).until_ns == 10
    assert make_condition([fault], 10).until_ns == 20
    later = [make_condition([fault], t, 1000) for t in (20, 1010)]  # of a world that begins then
    assert [(each.mocap.jump, each.until_ns) for each in later] == [(0.0, 1010), (1.0, 1020)]
    for bad in (("M99", 0), ("M4", 5, 5)):
        with pytest.raises(ValueError, match="fault"):
            Fault(*bad)
    with pytest.raises(ValueError, match="no setting 'kump'"):
        Fault("M4", 0, kump=1.0)
    condition = make_condition([Fault("M4"), Fault("M5"), Fault("V4")], 5)
    assert (condition.mocap.jump, condition.mocap.drift, condition.vesc.mute) == (0.5, 0.1, True)


# --- mocap
def datagrams(*faults: Fault) -> list[Datagram]:
    world = World(replace(DRIVING, keep_bytes=False), faults)
    world.mocap_write(0, natnet.encode(natnet.Bare.CONNECT))
    world.serial_write(0, b"")
    out: list[Datagram] = []
    for t in range(0, 3000 * MS, 10 * MS):
        world.vesc.motor.feed(t)
        out += world.mocap_read(t)
    return out


def frames(name: str, **params: Any) -> list[tuple[int, Frame]]:
    """What comes, and when, while a fault is on for a second."""
    return list(decoded(datagrams(Fault(name, ON, OFF, **params))))


def decoded(messages: list[Datagram]) -> Iterator[tuple[int, Frame]]:
    for message in messages:
        with contextlib.suppress(NatNetError):
            frame = natnet.decode(message.data, VERSION)
            if isinstance(frame, Frame) and message.channel != FOREIGN:
                yield message.t_ns, frame


def during(run: list[tuple[int, Frame]]) -> list[Frame]:
    return [f for t, f in run if ON + 20 * MS <= t < OFF]


CLEAN = list(decoded(datagrams()))


def test_m5_drift_grows_m21_the_clock_steps_and_the_model_changes():
    held = zip(during(frames("M5")), during(CLEAN), strict=True)
    off = [a.rigid_bodies[0].position[0] - b.rigid_bodies[0].position[0] for a, b in held]
    assert (off[0], off[-1]) == pytest.approx((0.002, 0.1), abs=0.003)
    for f, clean in zip(during(frames("M21")), during(CLEAN), strict=True):
        assert f.mid_exposure_ticks - clean.mid_exposure_ticks == pytest.approx(10**7, abs=200)
        assert f.transmit_ticks > f.mid_exposure_ticks
    assert all(f.params & MODEL_CHANGED for f in during(frames("model_change")))


def test_signs_that_alternate_do_so_from_frame_to_frame():
    turns, signs = ([f.rigid_bodies[0].quaternion[2:] for f in during(frames(name))]
                    for name in ("M7", "quaternion_sign"))  # fmt: skip
    flipped = [abs(2.0 * math.atan2(z, w)) > 1.5 for z, w in turns]
    for each in (flipped, [w > 0 for _, w in signs]):
        assert all(a != b for a, b in pairwise(each))


def test_m13_latency_m14_jitter_m15_out_of_order_m16_duplicated():
    clean = {f.number: t for t, f in CLEAN if 120 < f.number < 180}
    late, jitter = ([t - clean[f.number] for t, f in frames(name) if f.number in clean]
                    for name in ("M13", "M14"))  # fmt: skip
    assert late == [80 * MS] * len(clean)
    assert len(jitter) == len(clean)
    assert 0 <= min(jitter) < 5 * MS
    assert 30 * MS < max(jitter) < 40 * MS
    numbers, twice = ([f.number for f in during(frames(name))] for name in ("M15", "M16"))
    steps = [b - a for a, b in pairwise(numbers)]
    assert (min(steps), sorted(numbers)) == (-1, list(range(min(numbers), max(numbers) + 1)))
    assert twice[::2] == sorted(set(twice))


def test_m17_loss_m18_gap_m22_half_rate():
    assert 15 < 100 - len(during(frames("M17", loss=0.3))) < 50
    longest = max(b - a for (a, _), (b, _) in pairwise(frames("M18")))
    assert longest == pytest.approx(60 * MS, abs=5 * MS)
    half = [t for t, _ in frames("M22") if ON + 50 * MS < t < OFF]
    assert {round((b - a) / MS) for a, b in pairwise(half)} <= {19, 20, 21}


@pytest.mark.parametrize("how", ["truncated", "oversized", "garbage"])
def test_m19_malformed_datagrams_come_between_good_ones(how):
    messages, good = datagrams(Fault("M19", ON, OFF, noise=how)), {m.data for m in datagrams()}
    assert sum(m.data not in good for m in messages) > 90
    assert len(during(list(decoded(messages)))) >= 90


def test_m20_foreign_sender_forges_frames():
    messages = datagrams(Fault("M20", ON, OFF))
    forged = [m for m in messages if m.channel == FOREIGN]
    assert len(forged) > 90
    assert all(ON < m.t_ns < OFF + 20 * MS for m in forged)
    assert list(decoded(messages)) == CLEAN


def test_server_restart_begins_numbers_and_clock_again():
    world = World(DRIVING, [Fault("server_restart", ON, OFF)])
    numbers, ticks = [], []
    for t in range(0, 2000 * MS, 10 * MS):
        world.mocap_write(t, natnet.encode(natnet.Bare.CONNECT))
        for _, f in decoded(world.mocap_read(t)):
            numbers.append(f.number)
            ticks.append(f.mid_exposure_ticks)
    assert numbers.count(50) == 2
    assert sum(b < a for a, b in pairwise(ticks)) == 1


def test_half_open_tcp_is_silent_for_those_connected_before():
    config = replace(DRIVING, mocap=MocapConfig(kind="vrpn"))
    world = World(config, [Fault("half_open", ON)])
    world.mocap.on_connect(0, 1)
    assert [m for m in world.mocap_read(900 * MS) if m.peer == 1]
    world.mocap_read(1100 * MS)
    world.mocap.on_connect(1100 * MS, 2)
    later = world.mocap_read(1500 * MS)
    assert {m.peer for m in later} == {2}
    assert CLOSE not in {m.channel for m in later}


# --- serial
@pytest.fixture
def faulty(make_host) -> Callable[..., Any]:
    """A host that has driven at 1 m/s until the fault begins."""

    def make(name: str, **params: Any) -> Any:
        host = make_host(Fault(name, ON, OFF, **params), config=DRIVING)
        host.hold(980, c.SetErpm(4614))
        host.run(ON / MS - host.t_ns / MS)
        return host

    return make


def test_v2_other_name_and_v3_other_uuid_after_an_outage(faulty):
    host = faulty("V2")
    assert host.world.serial_name is None
    host.run(310)
    assert host.world.serial_name == "vesc-1"
    host = faulty("V3")
    own = host.world.config.vesc.uuid
    host.run(310)
    assert host.world.serial_name == "vesc"
    assert host.ask(c.GetFwVersion()).uuid != own


def test_v8_garbage_and_v9_crc_errors_and_v12_wrong_replies(faulty):
    host = faulty("V8")
    host.send(c.GetValues())
    host.run(1)
    assert len(host.world.serial_read(host.t_ns)) == 79 + 64
    host = faulty("V9", corrupt=1.0)
    for _ in range(20):
        host.send(c.GetValues())
        host.run(5)
        assert not any(isinstance(r, Values) and r.status == 0 for r in host.heard())
    host = faulty("V12")
    assert not isinstance(host.ask(c.GetValues()), Values)
    assert faulty("V12", wrong="length").ask(c.GetValues()).status is None
    old = faulty("V12", wrong="firmware").ask(c.GetValues())
    assert old.status is None
    assert old.controller_id == 107


def test_v11_false_long_header_comes_once_v24_appconf_without_timeout(faulty):
    host = faulty("V11")
    host.run(100)
    assert host.world.serial_read(host.t_ns) == b"\x03\x02\x00"
    reply = faulty("V24").ask(c.GetAppConf())
    assert (reply.timeout_ms, reply.timeout_brake_current) == (0, 0.0)


def test_v20_speed_sticks_and_v22_servo_stays(faulty):
    host, readings = faulty("V20"), set()
    for _ in range(10):
        host.hold(50, c.SetErpm(3 * 4614))
        readings.add(host.values().erpm)
    assert len(readings) == 1
    host = faulty("V22")
    before = host.world.car.state.steer
    host.hold(300, c.SetServoPos(0.2))
    assert host.world.car.state.steer == pytest.approx(before, abs=1e-6)


def test_v23_second_client_keeps_the_timeout_from_striking(make_host):
    host = make_host(Fault("V23"), timeout_ms=250)
    for _ in range(40):
        host.run(25)
        assert not host.values().status & 1


def test_lossy_jittery_and_chatty_links_still_work(faulty):
    for name in ("reply_loss", "reply_jitter", "unsolicited"):
        host = faulty(name)
        good = 0
        for _ in range(60):
            host.send(c.SetErpm(4614), c.GetValues())
            host.run(12)
            good += sum(isinstance(r, Values) for r in host.heard())
        assert good > 45, name
