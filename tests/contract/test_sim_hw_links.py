"""The simulated hardware in its own process, reached by other programs through real sockets."""

import os
import select
import socket
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from steerd.mocap_link import natnet
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.links import fault_windows, spawn_sim
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.sim_hw.world import WorldConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.identity import FwVersion
from steerd.vesc_link.packets import decode_reply, encode_command
from steerd.vesc_link.transport import LinkDown, open_port
from tests.contract.test_bus_contract import DEADLINE_S, until

VERSION_REQUEST = encode_frame(encode_command(c.GetFwVersion()))


def wait_for(fd: int) -> bool:
    return bool(select.select([fd], [], [], DEADLINE_S)[0])


def ask_version(fd: int) -> FwVersion:
    os.write(fd, VERSION_REQUEST)
    parser, end = FrameParser(), time.monotonic() + DEADLINE_S
    while time.monotonic() < end and wait_for(fd):
        if payloads := parser.feed(os.read(fd, 4096), 0):
            return decode_reply(payloads[0])
    raise TimeoutError("no version came")


def test_port_is_fresh_after_a_program_left_its_lock_and_bytes() -> None:
    with spawn_sim(WorldConfig()) as sim:
        fd = os.open(sim.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        os.write(fd, VERSION_REQUEST)
        assert wait_for(fd)  # the reply is left unread
        link = Path(sim.port)
        born = link.lstat().st_mtime_ns
        os.close(fd)
        assert until(lambda: link.is_symlink() and link.lstat().st_mtime_ns > born)
        with closing(open_port(sim.port)) as port:
            assert ask_version(port.fd).uuid == VescConfig().uuid


def test_process_ends_when_its_parent_lets_go_and_cleans_up() -> None:
    with spawn_sim(WorldConfig()) as sim:
        assert Path(sim.port).exists()
    assert sim.process.exitcode == 0
    assert not Path(sim.port).parent.exists()


def test_foreign_frames_come_from_another_address() -> None:
    with spawn_sim(WorldConfig(), (Fault("M20"),)) as sim:
        url = parse_mocap_url(sim.mocap_url)
        assert url.unicast
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.sendto(natnet.encode(natnet.Bare.CONNECT), (url.host, url.port))
            senders = set()
            for _ in range(12):
                assert wait_for(udp.fileno())
                senders.add(udp.recvfrom(65_536)[1][0])
    assert senders == {"127.0.0.1", "127.0.0.9"}


def test_reboot_hangs_up_and_the_port_comes_back() -> None:
    config = WorldConfig(vesc=replace(VescConfig(), reboot_ns=150_000_000))
    with spawn_sim(config) as sim:
        with closing(open_port(sim.port)) as port:
            port.write(encode_frame(encode_command(c.Reboot())))
            assert until(lambda: not Path(sim.port).exists())
            with pytest.raises(LinkDown):
                until(lambda: port.read() == b"never", 1.0)
        assert until(lambda: Path(sim.port).exists())
        with closing(open_port(sim.port)) as again:
            assert ask_version(again.fd).firmware == VescConfig().firmware


def test_simulated_hardware_alone_leaves_in_order_at_sigterm(tmp_path: Path) -> None:
    argv = [sys.executable, "-m", "steerd", "sim", "--link-dir", str(tmp_path)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as child:
        assert until((tmp_path / "vesc").exists, 20.0)
        child.terminate()
        printed, _ = child.communicate(timeout=DEADLINE_S)
    assert child.returncode == 0
    assert f"--port {tmp_path / 'vesc'} --mocap" in printed
    assert list(tmp_path.iterdir()) == []


def test_fault_windows_as_people_write_them() -> None:
    one, two, three = fault_windows(["M4", "jump@1.5", "V9@2-3"])
    assert (one.t_from_ns, one.kind, two.t_from_ns) == (0, two.kind, 1_500_000_000)
    assert (three.t_from_ns, three.t_to_ns) == (2_000_000_000, 3_000_000_000)
    with pytest.raises(ValueError, match="no fault"):
        fault_windows(["nonsense"])
