"""`steerd probe` against simulated hardware in another process."""

import json

import pytest

from steerd.daemon.cli.main import run_cli
from steerd.daemon.setup.probe_ask import discover
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.links import spawn_sim
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.sim_hw.world import WorldConfig
from steerd.steer_bus.clock import MonotonicClock


def probe(capsys, *arguments):
    code = run_cli(["probe", "--json", *arguments])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.realtime
def test_sound_hardware_is_described(capsys):
    with spawn_sim(WorldConfig()) as sim:
        code, found = probe(capsys, "--port", sim.port, "--mocap", sim.mocap_url)
        servers = discover(MonotonicClock(), ["127.0.0.1"], parse_mocap_url(sim.mocap_url).port)
    assert code == 0
    (port,), (source,) = found["serial"], found["mocap"]
    vesc = port["vesc"]
    assert tuple(vesc["firmware"]) == (VescConfig().firmware.major, VescConfig().firmware.minor)
    assert (vesc["uuid"], vesc["timeout_ms"]) == (VescConfig().uuid.hex(), VescConfig().timeout_ms)
    assert vesc["imu"]
    assert vesc["answered"] > 0.8
    told = port["advice"][0]["what"].split(":")[0]
    assert told == "the VESC does not report whether its servo output is on"
    assert source["bodies"] == ["car"]
    assert source["samples"] > 200
    assert (source["clock"], source["rate_hz"]) == ("echo", pytest.approx(100.0, rel=0.1))
    assert list(servers) == ["127.0.0.1"]
    assert "Motive" in servers["127.0.0.1"].name


def test_a_dead_port_and_a_silent_server(capsys, tmp_path):
    with spawn_sim(WorldConfig(), (Fault("no_replies"),)) as sim:
        code, found = probe(capsys, "--port", sim.port)
    assert code == 3
    assert "no VESC answered" in found["serial"][0]["advice"][0]["what"]
    code, found = probe(capsys, "--port", str(tmp_path / "ttyACM9"), "--mocap",
                        "natnet://127.0.0.1:9/car", "--seconds", "0.6")  # fmt: skip
    assert code == 3
    assert "99-vesc.rules" in found["serial"][0]["advice"][0]["fix"]
    assert "firewall" in found["mocap"][0]["advice"][0]["fix"]
