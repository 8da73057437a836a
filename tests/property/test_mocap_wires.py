"""NatNet and VRPN against random content and every truncation; damage: tests/safety/fuzz.py."""

import json
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.mocap_link import natnet, vrpn
from steerd.mocap_link.natnet_frame import Frame, RigidBody
from steerd.mocap_link.natnet_wire import NatNetError

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
def test_frames_survive_a_round_trip(version):
    @FIXED
    @given(frames)
    def check(frame: Frame) -> None:
        data = natnet.encode(frame, version)
        assert int.from_bytes(data[2:4], "little") == len(data) - 4
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
def test_every_truncation_is_refused_or_read(version):
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


@FIXED
@given(st.integers(-10, 10), st.binary(max_size=64), i32, i32)
def test_vrpn_messages_survive(kind, payload, sec, usec):
    message = vrpn.Message(kind, 3, sec, usec, payload, 9)
    data = vrpn.encode(message)
    assert len(data) % 8 == 0
    assert vrpn.decode_stream(data) == ([message], len(data))
    assert vrpn.decode_stream(data[:-1])[0] == []
