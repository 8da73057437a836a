"""A frame of rigid bodies alone, read in one piece: as the general way reads it, or not at all."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.mocap_link import natnet, natnet_frame
from steerd.mocap_link.natnet_frame import Frame, RigidBody
from steerd.mocap_link.natnet_wire import NatNetError

CHECKED = settings(derandomize=True, deadline=None, database=None, max_examples=200)
SINGLE = st.floats(width=32, allow_nan=False)
BODIES = st.builds(
    RigidBody,
    st.integers(0, 2**31 - 1),
    st.tuples(SINGLE, SINGLE, SINGLE),
    st.tuples(SINGLE, SINGLE, SINGLE, SINGLE),
    SINGLE,
    st.integers(0, 3),
)
FRAMES = st.builds(
    lambda number, bodies, ticks, params: natnet.encode(
        Frame(number, tuple(bodies), transmit_ticks=ticks, params=params), (4, 1)
    ),
    st.integers(0, 2**31 - 1),
    st.lists(BODIES, max_size=10),
    st.integers(0, 2**64 - 1),
    st.integers(0, 3),
)


def read(data):
    try:
        return repr(natnet.decode(data, (4, 1), detail=False))
    except NatNetError as error:
        return str(error)


def read_generally(data):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(natnet_frame, "_read_bodies_only", lambda data, at: None)
        return read(data)


@given(FRAMES)
@CHECKED
def test_whole_frames_are_the_same(data):
    assert read(data) == read_generally(data)


@given(FRAMES, st.integers(4, 600), st.integers(0, 255), st.integers(0, 3))
@CHECKED
def test_damaged_frames_are_the_same_or_refused_alike(data, at, byte, cut):
    at = 4 + at % (len(data) - 4)
    damaged = data[:at] + bytes((byte,)) + data[at + 1 : len(data) - cut]
    damaged = damaged[:2] + (len(damaged) - 4).to_bytes(2, "little") + damaged[4:]
    assert read(damaged) == read_generally(damaged)
