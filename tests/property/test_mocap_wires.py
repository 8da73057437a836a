"""NatNet and VRPN against random content, every truncation and thousands of corruptions."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.mocap_link import natnet, vrpn
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import NatNetSource
from steerd.mocap_link.natnet_frame import Frame, RigidBody
from steerd.mocap_link.natnet_wire import NatNetError
from steerd.mocap_link.vrpn_client import VrpnClient
from steerd.sim_hw.mocap.vrpn_device import VrpnServer

IP = "10.0.0.1"
VERSIONS = [(2, 9), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]
FIXED = settings(derandomize=True, deadline=None, database=None, max_examples=60)

f32 = st.floats(width=32, allow_nan=False)
f64 = st.floats(allow_nan=False)
i32 = st.integers(-(2**31), 2**31 - 1)
u64 = st.integers(0, 2**64 - 1)
i16 = st.integers(-(2**15), 2**15 - 1)
text = st.text(max_size=8).filter(lambda s: "\0" not in s and s.isprintable())
vec3 = st.tuples(f32, f32, f32)
vec4 = st.tuples(f32, f32, f32, f32)
few: dict[str, Any] = {"max_size": 3}


def tuples_of(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.lists(strategy, **few).map(tuple)


bodies = tuples_of(st.builds(RigidBody, i32, vec3, vec4, f32, i16))
frames = st.builds(Frame, i32, bodies, f64, u64, u64, u64, i16)


def keep(frame: Frame, version: tuple[int, int]) -> Frame:
    """Return what `version` can carry of a frame."""
    if version >= (3, 0):
        return frame
    return Frame(frame.number, frame.rigid_bodies, frame.timestamp, params=frame.params)


@pytest.mark.parametrize("version", VERSIONS)
def test_frames_survive_a_round_trip(version: tuple[int, int]) -> None:
    @FIXED
    @given(frames)
    def check(frame: Frame) -> None:
        data = natnet.encode(frame, version)
        assert natnet.has_exact_length(data)
        assert natnet.decode(data, version) == keep(frame, version)

    check()


RICH = json.loads((Path(__file__).parents[1] / "unit/mocap_link/natnet_rich.json").read_text())
"""A frame and a model with everything in them, for each version of the stream."""


def make_datagrams(version: tuple[int, int]) -> list[bytes]:
    major, minor = version
    return [
        bytes.fromhex(RICH[f"{major}.{minor}"]["frame"]),
        bytes.fromhex(RICH[f"{major}.{minor}"]["model"]),
        natnet.encode(natnet.ServerInfo("S", (1, 0, 0, 0), (major, minor, 0, 0), 1000), version),
        natnet.encode(natnet.EchoResponse(1, 2), version),
    ]


@pytest.mark.parametrize("version", VERSIONS)
def test_every_truncation_is_refused_or_read(version: tuple[int, int]) -> None:
    for data in make_datagrams(version):
        whole = natnet.decode(data, version)
        for size in range(len(data)):
            for cut in (data[:size], data[:2] + struct.pack("<H", max(0, size - 4)) + data[4:size]):
                try:
                    message = natnet.decode(cut, version)
                except NatNetError:
                    continue
                # an empty string or a shorter list is a message too; a frame never is
                assert not isinstance(message, Frame)
                # and a list before 4.1 is whole without the item of a kind that ends it
                ended = isinstance(message, natnet.ModelDef) and version < (4, 1)
                assert ended or message != whole


@pytest.mark.parametrize("version", VERSIONS)
def test_random_corruption_never_raises_out_of_the_client(version: tuple[int, int]) -> None:
    rng = np.random.default_rng(7)
    client = NatNetSource("car", IP, IngestConfig())
    for data in make_datagrams(version):
        client.on_datagram(make_datagrams(version)[2], 0, IP)
        for i in range(1500):
            bad = bytearray(data)
            for at in rng.integers(2, len(data), 3):
                bad[at] = rng.integers(256)
            client.on_datagram(bytes(bad), i, IP)
    assert client.counts["malformed"] > 1000


@FIXED
@given(st.binary(max_size=200))
def test_byte_soup_never_raises(data: bytes) -> None:
    for version in VERSIONS:
        client = NatNetSource("car", IP, IngestConfig())
        client.on_datagram(make_datagrams(version)[2], 0, IP)
        client.on_datagram(data, 1, IP, "command")
        client.on_datagram(data, 2, IP, "data")
        client.on_timer(3)


def make_stream() -> bytes:
    server = VrpnServer(("car", "b2"))
    stream = server.hello()
    for i in range(20):
        name = ("car", "b2")[i % 2]
        stream += server.pose(name, 1_000_000 + i, (i * 0.1, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0))
    return stream


@FIXED
@given(st.lists(st.integers(1, 40), min_size=1, max_size=200))
def test_any_chunking_gives_the_same_poses(sizes: list[int]) -> None:
    stream = make_stream()
    whole = VrpnClient("car").on_bytes(stream, 0)
    client, at, got = VrpnClient("car"), 0, []
    for size in (*sizes, len(stream)):
        got += client.on_bytes(stream[at : at + size], 0)
        at += size
    assert got == whole
    assert [round(p.position[0], 6) for p in got] == [round(0.2 * i, 6) for i in range(10)]


def test_corrupted_streams_never_raise() -> None:
    rng = np.random.default_rng(3)
    stream = make_stream()
    dead = 0
    for _ in range(2000):
        bad = bytearray(stream)
        for at in rng.integers(0, len(bad), 3):
            bad[at] = rng.integers(256)
        client = VrpnClient("car")
        client.on_bytes(bytes(bad), 0)
        client.on_timer(1)
        dead += client.dead is not None
    assert dead > 20


@FIXED
@given(st.integers(-10, 10), st.binary(max_size=64), i32, i32)
def test_vrpn_messages_survive(kind: int, payload: bytes, sec: int, usec: int) -> None:
    message = vrpn.Message(kind, 3, sec, usec, payload, 9)
    data = vrpn.encode(message)
    assert len(data) % 8 == 0
    assert vrpn.decode_stream(data) == ([message], len(data))
    assert vrpn.decode_stream(data[:-1])[0] == []
