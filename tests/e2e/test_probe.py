"""`steerd probe` against simulated hardware in another process."""

import json

import pytest

from steerd.daemon.setup.probe_ask import discover
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.links import spawn_sim
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.sim_hw.world import WorldConfig
from steerd.steer_bus.clock import MonotonicClock


@pytest.fixture
def probe(cli):
    """What the command finds."""
    return lambda *words, **ends: json.loads(cli("probe", "--json", *words, **ends).out)


@pytest.mark.realtime
def test_sound_hardware_is_described(probe):
    with spawn_sim(WorldConfig()) as sim:
        found = probe("--port", sim.port, "--mocap", sim.mocap_url)
        servers = discover(MonotonicClock(), ["127.0.0.1"], parse_mocap_url(sim.mocap_url).port)
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


def test_a_dead_port_and_a_silent_server(probe, tmp_path):
    with spawn_sim(WorldConfig(), (Fault("no_replies"),)) as sim:
        found = probe("--port", sim.port, code=3)
    assert "no VESC answered" in found["serial"][0]["advice"][0]["what"]
    found = probe("--port", tmp_path / "ttyACM9", "--mocap", "natnet://127.0.0.1:9/car",
                  "--seconds", 0.6, code=3)  # fmt: skip
    assert "99-vesc.rules" in found["serial"][0]["advice"][0]["fix"]
    assert "firewall" in found["mocap"][0]["advice"][0]["fix"]
