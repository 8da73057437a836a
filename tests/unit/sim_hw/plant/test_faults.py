"""Every fault of the catalogue does what it says, seen on the bytes that a host gets."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from steerd.car_model.state import ORIGIN
from steerd.mocap_link import natnet
from steerd.mocap_link.natnet_frame import EDIT_MODE, MODEL_CHANGED, Frame
from steerd.mocap_link.natnet_wire import NatNetError
from steerd.sim_hw.mocap.cameras import Bystander, MocapConfig
from steerd.sim_hw.mocap.network import CLOSE, FOREIGN, Datagram
from steerd.sim_hw.plant import faults
from steerd.sim_hw.plant.faults import FAULTS, Fault, find_fault, make_condition
from steerd.sim_hw.vesc.vesc_motor import STATUS_KILL
from steerd.sim_hw.world import World, WorldConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link.identity import AppConf
from steerd.vesc_link.telemetry import Values

MS = 1_000_000
ON, OFF = 1000 * MS, 2000 * MS
MakeHost = Callable[..., Any]
VERSION = MocapConfig().version
DRIVING = WorldConfig(
    start=ORIGIN._replace(speed=1.0),
    mocap=MocapConfig(bystanders=(Bystander("box", 2, (3, 1, 0)),)),
)


# --- the catalogue


def test_catalogue_is_complete_and_each_entry_changes_the_fault_state():
    codes = [kind.code for kind in FAULTS if kind.code]
    assert codes == [f"M{n}" for n in range(1, 23)] + [f"V{n}" for n in range(1, 25)]
    for kind in FAULTS:
        condition = make_condition([Fault(kind.name)], 1 << 40)
        changed = (condition.vesc, condition.mocap) != (faults.HEALTHY_VESC, faults.HEALTHY_MOCAP)
        assert changed, kind.name
        assert (condition.vesc == faults.HEALTHY_VESC) == (kind.target == "mocap")


def test_windows_edges_and_mistakes():
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


def test_faults_at_the_same_time_add_up():
    condition = make_condition([Fault("M4"), Fault("M5"), Fault("V4")], 5)
    assert (condition.mocap.jump, condition.mocap.drift, condition.vesc.mute) == (0.5, 0.1, True)


# --- mocap


def datagrams(*faults: Fault, config: WorldConfig = DRIVING, until: int = 3000) -> list[Datagram]:
    world = World(replace(config, keep_bytes=False), faults)
    world.mocap_write(0, natnet.encode(natnet.Bare.CONNECT))
    world.serial_write(0, b"")
    out: list[Datagram] = []
    for t in range(0, until * MS, 10 * MS):
        world.vesc.motor.feed(t)
        out += world.mocap_read(t)
    return out


def frames(*faults: Fault, config: WorldConfig = DRIVING) -> list[tuple[int, Frame]]:
    return list(decoded(datagrams(*faults, config=config)))


def decoded(messages: list[Datagram]) -> Iterator[tuple[int, Frame]]:
    for message in messages:
        if message.channel == FOREIGN:
            continue
        try:
            frame = natnet.decode(message.data, VERSION)
        except NatNetError:
            continue
        if isinstance(frame, Frame):
            yield message.t_ns, frame


def during(run: list[tuple[int, Frame]]) -> list[Frame]:
    return [f for t, f in run if ON + 20 * MS <= t < OFF]


def outside(run: list[tuple[int, Frame]]) -> list[Frame]:
    return [f for t, f in run if t < ON or t > OFF + 200 * MS]


def place(frame: Frame, body: int = 0) -> tuple[float, ...]:
    return frame.rigid_bodies[body].position


def yaw(frame: Frame) -> float:
    _x, _y, z, w = frame.rigid_bodies[0].quaternion
    return 2.0 * math.atan2(z, w)


CLEAN = frames()


def test_m1_silence():
    run = frames(Fault("M1", ON, OFF))
    assert during(run) == []
    assert outside(run) == outside(CLEAN)


def test_m2_freeze_keeps_the_pose_bit_for_bit_with_new_stamps():
    held = during(frames(Fault("M2", ON, OFF)))
    assert len({f.rigid_bodies[0] for f in held}) == 1
    ticks = [f.mid_exposure_ticks for f in held]
    assert all(b > a for a, b in pairwise(ticks))


def test_m3_resend_is_one_frame_again_and_again():
    held = during(frames(Fault("M3", ON, OFF)))
    assert len(held) > 90
    assert len(set(held)) == 1


def test_m4_jump_and_m5_drift_move_the_pose():
    clean = during(CLEAN)
    for name, at_start, at_end in (("M4", 0.5, 0.5), ("M5", 0.002, 0.1)):
        held = during(frames(Fault(name, ON, OFF)))
        off = [
            a.rigid_bodies[0].position[0] - b.rigid_bodies[0].position[0]
            for a, b in zip(held, clean, strict=True)
        ]
        assert off[0] == pytest.approx(at_start, abs=0.003)
        assert off[-1] == pytest.approx(at_end, abs=0.003)


THERE = pytest.approx((3.0, 1.0), abs=0.002)  # where the box stands
SHOWN: dict[str, Callable[[Frame, Frame], bool]] = {
    "M6": lambda f, _: abs(yaw(f)) > 3.0,
    "M8": lambda f, _: all(map(math.isnan, (*place(f), *f.rigid_bodies[0].quaternion))),
    "M9": lambda f, _: not any((*place(f), *f.rigid_bodies[0].quaternion)),
    "M10": lambda f, clean: place(f) == pytest.approx([1e3 * v for v in place(clean)], rel=1e-6),
    "M11": lambda f, _: place(f)[:2] == THERE,
    "M12": lambda f, clean: (
        place(f)[:2] == THERE and place(f, 1) == pytest.approx(place(clean), abs=0.003)
    ),
    "invalid": lambda f, _: not f.rigid_bodies[0].tracking_valid,
    "body_removed": lambda f, _: len(f.rigid_bodies) == 1,
    "M21": lambda f, clean: (
        f.mid_exposure_ticks - clean.mid_exposure_ticks == pytest.approx(10_000_000, abs=200)
        and f.transmit_ticks > f.mid_exposure_ticks
    ),
    "mean_error_ramp": lambda f, _: f.rigid_bodies[0].mean_error > 0.005,
    "edit_mode": lambda f, _: bool(f.params & EDIT_MODE),
    "model_change": lambda f, _: bool(f.params & MODEL_CHANGED),
}
"""What a fault does to each frame, beside the same frame without it."""


@pytest.mark.parametrize("name", SHOWN)
def test_every_frame_shows_its_fault(name):
    for held, clean in zip(during(frames(Fault(name, ON, OFF))), during(CLEAN), strict=True):
        assert SHOWN[name](held, clean)


def test_signs_that_alternate_do_so_from_frame_to_frame():
    flipped = [abs(yaw(f)) > 1.5 for f in during(frames(Fault("M7", ON, OFF)))]
    held = during(frames(Fault("quaternion_sign", ON, OFF)))
    signs = [f.rigid_bodies[0].quaternion[3] > 0 for f in held]
    for each in (flipped, signs):
        assert all(a != b for a, b in pairwise(each))


def test_m13_latency_m14_jitter():
    late = [t for t, f in frames(Fault("M13", ON, OFF)) if 120 < f.number < 180]
    clean = [t for t, f in CLEAN if 120 < f.number < 180]
    assert {b - a for a, b in zip(clean, late, strict=True)} == {80 * MS}
    jittery = {f.number: t for t, f in frames(Fault("M14", ON, OFF))}
    spread = [jittery[f.number] - t for t, f in CLEAN if 120 < f.number < 180]
    assert 0 <= min(spread) < 5 * MS
    assert 30 * MS < max(spread) < 40 * MS


def test_m15_out_of_order_m16_duplicated():
    numbers = [f.number for f in during(frames(Fault("M15", ON, OFF)))]
    steps = [b - a for a, b in pairwise(numbers)]
    assert min(steps) == -1
    assert sorted(numbers) == list(range(min(numbers), max(numbers) + 1))
    twice = [f.number for f in during(frames(Fault("M16", ON, OFF)))]
    assert [n for i, n in enumerate(twice) if i % 2 == 0] == sorted(set(twice))


def test_m17_loss_m18_gap_m22_half_rate():
    lost = 100 - len(during(frames(Fault("M17", ON, OFF, loss=0.3))))
    assert 15 < lost < 50
    gap = frames(Fault("M18", ON, OFF))
    times = [t for t, _ in gap]
    assert max(b - a for a, b in pairwise(times)) == pytest.approx(60 * MS, abs=5 * MS)
    half = [t for t, _ in frames(Fault("M22", ON, OFF)) if ON + 50 * MS < t < OFF]
    gaps = {round((b - a) / MS) for a, b in pairwise(half)}
    assert gaps <= {19, 20, 21}


@pytest.mark.parametrize("how", ["truncated", "oversized", "garbage"])
def test_m19_malformed_datagrams_come_between_good_ones(how):
    messages = datagrams(Fault("M19", ON, OFF, noise=how))
    good = {m.data for m in datagrams()}
    bad = [m for m in messages if m.data not in good]
    assert len(bad) > 90
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
def faulty(make_host: MakeHost) -> Callable[..., Any]:
    """A host that has driven at 1 m/s until the fault begins."""

    def make(name: str, **params: Any) -> Any:
        host = make_host(Fault(name, ON, OFF, **params), config=DRIVING)
        host.hold(980, c.SetErpm(4614))
        host.run(ON / MS - host.t_ns / MS)
        return host

    return make


def test_v1_unplug_is_eio_and_the_firmware_timeout_stops_the_car(faulty):
    host = faulty("V1")
    for use in (lambda: host.send(c.GetValues()), lambda: host.world.serial_read(host.t_ns)):
        with pytest.raises(OSError, match="Input/output"):
            use()
    host.run(900)
    assert host.world.serial_name is None
    assert host.speed == 0.0
    host.run(200)
    assert isinstance(host.values(), Values)


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


def test_v4_mute_obeys_but_says_nothing(faulty):
    host = faulty("V4")
    host.send(c.GetValues())
    host.hold(300, c.SetErpm(2 * 4614))
    assert host.heard() == []
    assert host.speed > 1.5


def test_v5_deaf_answers_and_drives_on_whatever_it_is_commanded(faulty):
    host = faulty("V5")
    host.hold(400, c.SetCurrentBrake(20.0))
    host.run(400)
    assert host.speed == pytest.approx(1.0, abs=0.02)
    assert host.values().fault == 0


def test_v6_stalled_reader_fills_the_hosts_buffer(faulty):
    host = faulty("V6")
    assert host.world.serial_write(host.t_ns, bytes(4000)) == 4000
    assert host.world.serial_write(host.t_ns, bytes(200)) == 96
    with pytest.raises(BlockingIOError):
        host.world.serial_write(host.t_ns, b"x")


def test_v7_trickle_takes_5_ms_per_byte(faulty):
    host = faulty("V7")
    host.send(c.GetValuesSelective(0x180))  # 17 bytes
    host.run(79)
    assert host.heard() == []
    host.run(12)
    assert isinstance(host.heard()[0], Values)


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
    assert host.parser.crc_errors + host.parser.dropped_bytes > 0
    host = faulty("V12")
    assert not isinstance(host.ask(c.GetValues()), Values)
    assert host.parser.frames > 0
    assert faulty("V12", wrong="length").ask(c.GetValues()).status is None
    old = faulty("V12", wrong="firmware").ask(c.GetValues())
    assert old.status is None
    assert old.controller_id == 107


def test_v10_partial_frame_then_silence(faulty):
    host = faulty("V10")
    host.send(c.GetValues())
    host.run(5)
    assert len(host.world.serial_read(host.t_ns)) == 39
    host.send(c.GetValues())
    host.run(5)
    assert host.world.serial_read(host.t_ns) == b""


def test_v11_false_long_header_comes_once(faulty):
    host = faulty("V11")
    host.run(100)
    assert host.world.serial_read(host.t_ns) == b"\x03\x02\x00"


def test_v13_to_v17_fault_codes(faulty):
    for name, code in (("V13", 3), ("V16", 2), ("V17", 5)):
        host = faulty(name)
        host.hold(900, c.SetErpm(4614))
        values = host.values()
        assert values.fault == code, name
        assert host.speed < 0.6, name
    assert values.temp_fet_c > 100.0  # V17
    host = faulty("V14")
    assert host.values().fault == 4
    host.hold(520, c.SetErpm(4614))
    assert host.values().fault == 0


def test_v15_reboot_drops_usb_and_coasts(faulty):
    host = faulty("V15")
    assert host.world.serial_name is None
    host.run(1000)
    assert host.speed == pytest.approx(0.4, abs=0.05)
    host.run(600)
    assert host.ask(c.GetValuesSetupSelective(0x200000)).uptime_ms < 200


def test_v18_to_v21_wrong_telemetry(faulty):
    assert faulty("V18").values().status & 1
    assert faulty("V19").values().status & STATUS_KILL
    host = faulty("V20")
    readings = set()
    for _ in range(10):
        host.hold(50, c.SetErpm(3 * 4614))
        readings.add(host.values().erpm)
    assert len(readings) == 1
    assert faulty("V21").values().erpm == pytest.approx(-4614, abs=60)


def test_v22_servo_stays(faulty):
    host = faulty("V22")
    before = host.world.car.state.steer
    host.hold(300, c.SetServoPos(0.2))
    assert host.world.car.state.steer == pytest.approx(before, abs=1e-6)


def test_v23_second_client_keeps_the_timeout_from_striking(make_host):
    host = make_host(Fault("V23"), timeout_ms=250)
    for _ in range(40):
        host.run(25)
        assert not host.values().status & 1


def test_v24_appconf_without_timeout(faulty):
    reply = faulty("V24").ask(c.GetAppConf())
    assert isinstance(reply, AppConf)
    assert (reply.timeout_ms, reply.timeout_brake_current) == (0, 0.0)


def test_lossy_jittery_and_chatty_links_still_work(faulty):
    for name in ("reply_loss", "reply_jitter", "unsolicited"):
        host = faulty(name)
        good = 0
        for _ in range(60):
            host.send(c.SetErpm(4614), c.GetValues())
            host.run(12)
            good += sum(isinstance(r, Values) for r in host.heard())
        assert good > 45, name
