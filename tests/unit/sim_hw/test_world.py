"""The world as a whole: repeatable to the byte, drivable, and understood by the real clients."""

import hashlib
from typing import Any

import pytest

from steerd.car_model.effects import parse_effects
from steerd.car_model.model import Model
from steerd.car_model.params import DEFAULT_CAR
from steerd.mocap_link import natnet
from steerd.sim_hw.mocap.cameras import MocapConfig
from steerd.sim_hw.mocap.network import STREAM
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.sim_hw.world import World, WorldConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.packets import encode_command
from steerd.vesc_link.telemetry import FAST_MASK

MS = 1_000_000
TICK = 10 * MS
POLL = encode_frame(encode_command(c.GetValuesSelective(FAST_MASK)))


def drive_bytes(config: WorldConfig, faults: list[Fault], step: int = TICK) -> str:
    """SHA-256 of everything that came out of a drive."""
    world = World(config, faults)
    world.mocap_write(0, natnet.encode(natnet.Bare.CONNECT))
    digest = hashlib.sha256()
    for t in range(0, 2000 * MS, TICK):
        orders = encode_frame(encode_command(c.SetErpm(3000 + t // MS)))
        orders += encode_frame(encode_command(c.SetServoPos(0.4 + (t // TICK) % 7 / 40)))
        world.serial_write(t, orders + POLL)
        for later in range(t + step, t + TICK, step):
            world.advance(later)
        digest.update(world.serial_read(t + TICK - 1))
        for message in world.mocap_read(t + TICK - 1):
            digest.update(repr(message).encode())
    digest.update(repr((world.car.t_ns, world.car.state, world.car.accel_x)).encode())
    digest.update(repr(world.log).encode())
    return digest.hexdigest()


NOISY = WorldConfig(seed=5, process_noise=(0.05, 0.2, 0.05))
FAULTS = [Fault("M17", loss=0.1), Fault("V9", corrupt=0.1), Fault("M14", 500 * MS, 900 * MS)]


def test_a_hand_pushes_the_car_a_metre_and_back() -> None:
    world = World(WorldConfig())
    for far in (1.1, 0.0):
        world.push()
        world.advance(world.t_ns + 4000 * MS)
        assert world.car.state.x == pytest.approx(far, abs=0.1)


def test_how_time_is_cut_up_changes_nothing() -> None:
    assert drive_bytes(NOISY, []) == drive_bytes(NOISY, [], step=1 * MS)


def test_a_device_that_draws_more_numbers_changes_nothing_for_the_others() -> None:
    quiet, polled = World(NOISY), World(NOISY)
    for t in range(0, 500 * MS, TICK):
        for world in (quiet, polled):
            world.serial_write(t, encode_frame(encode_command(c.SetErpm(4614))))
        polled.serial_write(t, POLL * 3)
        polled.serial_read(t + 5 * MS)
    quiet.advance(polled.t_ns)
    assert (quiet.car.t_ns, quiet.car.state) == (polled.car.t_ns, polled.car.state)


@pytest.mark.parametrize("faults", [[], FAULTS, [Fault("V2", 300 * MS, 700 * MS)]])
def test_a_caller_woken_on_time_reads_everything_the_moment_it_arrives(faults: list[Fault]) -> None:
    world = World(NOISY, faults)
    world.mocap_write(0, natnet.encode(natnet.Bare.CONNECT))
    t, wakes, poses, unplugged = 0, 0, 0, 0
    while t < 1000 * MS:
        if wakes % 5 == 0 and world.serial_name is not None:
            world.serial_write(t, POLL)
        t = max(world.next_wake_ns, t + 1)
        wakes += 1
        world.advance(t)
        before = len(world.log)
        if world.serial_name is not None:
            world.serial_read(t)
        arrived = [entry.t_ns for entry in world.log[before:] if entry.to == "host"]
        arrived += [message.t_ns for message in world.mocap_read(t)]
        assert set(arrived) <= {t}
        poses += len(arrived)
        unplugged += world.serial_name is None
    assert poses > 100
    assert wakes < 1200
    assert (unplugged > 0) == any(fault.kind.code == "V2" for fault in faults)


def test_natnet_answers_survives_nonsense_and_drops_the_silent_and_vrpn_who_is_none() -> None:
    world = World(WorldConfig(mocap=MocapConfig(keepalive_ns=500 * MS)))
    assert world.mocap_read(100 * MS) == []  # nobody has connected yet
    world.mocap_write(100 * MS, natnet.encode(natnet.Bare.CONNECT))
    assert len(world.mocap_read(500 * MS)) > 30
    world.mocap_read(700 * MS)
    assert world.mocap_read(1500 * MS) == []
    world = World(WorldConfig(mocap=MocapConfig(multicast=True, rate_hz=120)))
    for junk in (b"", b"\x07", b"\x00\x00\xff\xff", bytes(300)):
        world.mocap_write(0, junk)
    world.mocap_write(0, natnet.encode(natnet.Request("FrameRate")), peer=3)
    world.mocap_write(0, natnet.encode(natnet.Request("Nonsense")), peer=4)
    answers = {m.peer: natnet.decode(m.data, (4, 1)) for m in world.mocap_read(MS)}
    assert answers[3].number == 120.0
    assert isinstance(answers[4], natnet.Unrecognized)
    world = World(WorldConfig(mocap=MocapConfig(kind="vrpn")))
    world.mocap.on_connect(0, 0)
    world.mocap_write(0, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", STREAM)
    assert world.mocap_read(MS)[-1].channel == "close"


def test_effects_change_the_car_and_pose_latency_is_not_stamped(make_host) -> None:
    def end(text: str | None) -> Any:
        setting = parse_effects(text) if text else []
        effects, values = (tuple(each[i] for each in setting) for i in (0, 1))
        host = make_host(config=WorldConfig(model=Model(DEFAULT_CAR, effects, values)))
        host.hold(1000, c.SetErpm(2 * 4614))
        return host.world.car.state, host.world.car.observe_pose(host.t_ns)

    plain, latency = end(None), end("mocap_latency=0.05")
    assert plain[0] == latency[0]
    assert plain[1].x - latency[1].x == pytest.approx(0.05 * 2.0, abs=0.01)
    assert end("drive_delay=0.1")[0].x < plain[0].x - 0.1


def test_the_servo_signals_own_wait_is_half_its_frame() -> None:
    found = [WorldConfig(vesc=VescConfig(servo_out=out)).servo_wait for out in (True, False)]
    assert found == [0.01, 0.0]
