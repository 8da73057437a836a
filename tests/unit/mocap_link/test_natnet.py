"""NatNet: golden vectors and the session's corners; the real capture is played in `e2e`."""

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.mocap_link import natnet, natnet_wire
from steerd.mocap_link.ingest import IngestConfig
from steerd.mocap_link.natnet_client import UNANSWERED, NatNetSource
from steerd.mocap_link.natnet_wire import Frame, NatNetError, RigidBody

SPEC = json.loads(Path(__file__).with_name("natnet_rich.json").read_text())
RICH = {
    tuple(map(int, version.split("."))): {name: bytes.fromhex(data) for name, data in each.items()}
    for version, each in SPEC.items()
}
"""A frame and a model with everything in them, and plain frames, by version of the stream."""


@pytest.mark.parametrize("version", [(3, 0), (4, 1)])
def test_golden_frame(version):
    data = RICH[version]["plain"]
    frame = natnet.decode(data, version)
    (body,) = frame.rigid_bodies
    assert (frame.number, body.id, body.position) == (7, 42, (1.0, 2.0, 3.0))
    assert body.quaternion == pytest.approx((0.1, 0.2, 0.3, 0.9))
    assert body.mean_error == pytest.approx(5e-4)
    assert body.tracking_valid
    assert frame.timestamp == 1.25
    ticks = (frame.mid_exposure_ticks, frame.data_received_ticks, frame.transmit_ticks)
    assert (ticks, frame.params) == ((111, 222, 333), natnet_wire.MODEL_CHANGED)
    if version >= (4, 1):
        data = data[:150] + bytes(8) + data[158:]  # the precise stamp is read over
    assert natnet.encode(frame, version) == data


@pytest.mark.parametrize("version", RICH)
def test_what_is_not_used_is_passed_over_and_an_unknown_kind_ends_the_list_before_4_1(version):
    frame = natnet.decode(RICH[version]["frame"], version)
    body = RigidBody(1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    ticks = (4, 5, 6) if version >= (3, 0) else (0, 0, 0)
    assert frame == Frame(5, (body, body), 3.0, *ticks, params=2)
    model = natnet.decode(RICH[version]["model"], version)
    known = [(body.name, body.id) for body in model.rigid_bodies]
    assert known == [("hip", 1), ("car", 7), *([("last", 8)] if version >= (4, 1) else [])]


def test_short_and_long_forms_are_read_and_stopped_clocks_and_what_does_not_fit_refused():
    assert natnet.decode(b"\0\0\x05\0Ping\0", (3, 0)) is natnet.Bare.CONNECT
    assert natnet.decode(bytes(4), (3, 0)) is natnet.Bare.CONNECT
    assert natnet.Response(b"\0\0\xf0\x42").number == 120.0
    assert natnet.Response(b"text\0").number is None
    data = RICH[3, 0]["plain"]
    assert natnet.decode(data + b"junk", (3, 0)) == natnet.decode(data, (3, 0))
    data = natnet.encode(natnet.ServerInfo("S", (1, 0, 0, 0), (3, 0, 0, 0), 0))
    with pytest.raises(NatNetError, match="0 Hz"):
        natnet.decode(data, (3, 0))
    for message in (natnet.EchoRequest(-1), natnet.Response(bytes(70_000))):
        with pytest.raises(NatNetError):
            natnet.encode(message)


@pytest.mark.parametrize(("version", "at", "number", "said"), [
    *(((3, 0), 8, n, "count") for n in (-1, 10_001, 2**31 - 1)), ((4, 1), 28, 37, "size"),
])  # fmt: skip
def test_absurd_counts_and_sizes_are_refused(version, at, number, said):
    data = bytearray(RICH[version]["plain"])
    data[at : at + 4] = number.to_bytes(4, "little", signed=True)
    with pytest.raises(NatNetError, match=said):
        natnet.decode(bytes(data), version)


# Corners of the NatNet session that a room's ordinary faults do not reach.
MS = 1_000_000
SECOND = 1000 * MS
IP = "10.0.0.1"

INFO = natnet.ServerInfo("Fake", (1, 0, 0, 0), (4, 1, 0, 0), 3_312_787, 1511, True, "239.255.42.99")
MODEL = natnet.ModelDef((natnet.RigidBodyDesc("car", 1), natnet.RigidBodyDesc("b2", 2)))


@pytest.fixture
def client() -> NatNetSource:
    """A source that follows `car` of a server 4.1."""
    client = NatNetSource("car", IP, IngestConfig())
    for t_ns, reply in enumerate((INFO, MODEL)):
        client.on_timer(2 * t_ns)
        client.on_datagram(natnet.encode(reply), 2 * t_ns + 1, IP)
    assert client.info == INFO
    assert client.connected
    assert client.detail == "following 'car' (id 1)"
    return client


def sent_by(client: NatNetSource, t_ns: int) -> list[natnet.Message]:
    return [natnet.decode(datagram, (4, 1)) for datagram in client.on_timer(t_ns)]


def make_frame(version: tuple[int, int] = (4, 1), **fields: Any) -> bytes:
    body = RigidBody(1, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 0.9))
    return natnet.encode(Frame(9, (body,), **fields), version)


def test_a_host_that_never_answers_is_reported_after_three_seconds_with_what_to_check():
    client = NatNetSource("car", IP, IngestConfig())
    for t_ns in range(5 * SECOND, 8 * SECOND, 100 * MS):
        client.on_timer(t_ns)
        assert client.detail == "waiting for the server to answer"
    client.on_timer(8 * SECOND)
    assert client.detail == UNANSWERED
    assert not client.refused


def test_cameras_need_not_stamp_exposure_and_what_the_server_says_is_passed_on(client):
    for stamped, ticks in (({"transmit_ticks": 200}, 200), ({}, None)):
        (raw,) = client.on_datagram(make_frame(**stamped), 7, IP, "data")
        assert raw.source_ticks == ticks
    client.on_datagram(natnet.encode(natnet.MessageString("licence expired")), 5, IP)
    assert client.detail == "server: licence expired"


@pytest.mark.parametrize("goodbye", [natnet.Bare.DISCONNECT, natnet.Bare.DISCONNECT_BY_TIMEOUT])
def test_a_server_that_says_goodbye_is_called_again(client, goodbye):
    client.on_datagram(natnet.encode(goodbye), 10, IP)
    assert not client.connected
    assert natnet.Bare.CONNECT in sent_by(client, SECOND)


def test_a_changed_bitstream_asks_who_is_there(client):
    client.on_datagram(make_frame(params=natnet_wire.BITSTREAM_CHANGED), 10, IP, "data")
    assert not client.connected
    now = replace(INFO, natnet_version=(3, 0, 0, 0))
    client.on_datagram(natnet.encode(now, (3, 0)), 11, IP)
    assert client.info == now
    assert len(client.on_datagram(make_frame((3, 0)), 12, IP, "data")) == 1


def test_a_changed_model_is_asked_for_and_followed(client):
    client.on_datagram(make_frame(params=natnet_wire.MODEL_CHANGED), 10, IP, "data")
    assert sent_by(client, 300 * MS).count(natnet.Bare.REQUEST_MODEL) == 1
    model = natnet.ModelDef((natnet.RigidBodyDesc("car", 7),))
    client.on_datagram(natnet.encode(model), 301 * MS, IP)
    assert client.detail == "following 'car' (id 7)"


def test_frames_of_another_version_ask_who_is_there(client):
    for i in range(10):
        assert client.on_datagram(make_frame((3, 0)), 10 + i, IP, "data") == []
    assert not client.connected
    assert "do not decode" in client.detail


def test_an_echo_counts_once_and_only_if_requested(client):
    (echo,) = [m for m in sent_by(client, 50 * MS) if isinstance(m, natnet.EchoRequest)]
    measured: list[tuple[int, ...]] = []
    client.ingest.timing.echo.add = lambda *times: measured.append(times)
    for ms, stamp in ((60, echo.client_stamp), (61, echo.client_stamp), (62, 123)):
        client.on_datagram(natnet.encode(natnet.EchoResponse(stamp, 77)), ms * MS, IP)
    assert measured == [(50 * MS, 60 * MS, 77)]


def test_forced_transport_goes_before_the_servers_word():
    for forced, expected in ((None, False), (True, True), (False, False)):
        client = NatNetSource("car", IP, IngestConfig(), unicast=forced)
        client.on_datagram(natnet.encode(INFO), 0, IP)
        assert client.unicast is expected


NO_TICKS = dict.fromkeys(("mid_exposure_ticks", "data_received_ticks", "transmit_ticks"), 0)
FIXED = settings(derandomize=True, deadline=None, database=None, max_examples=60)

f32, f64 = st.floats(width=32, allow_nan=False), st.floats(allow_nan=False)
i16, i32 = (st.integers(-(2**bits), 2**bits - 1) for bits in (15, 31))
u64 = st.integers(0, 2**64 - 1)
body = st.builds(RigidBody, i32, st.tuples(f32, f32, f32), st.tuples(*[f32] * 4), f32, i16)
frames = st.builds(Frame, i32, st.lists(body, max_size=3).map(tuple), f64, u64, u64, u64, i16)


@pytest.mark.parametrize("version", RICH)
def test_frames_survive_a_round_trip(version):
    @FIXED
    @given(frames)
    def check(frame: Frame) -> None:
        data = natnet.encode(frame, version)
        assert int.from_bytes(data[2:4], "little") == len(data) - 4
        kept = frame if version >= (3, 0) else replace(frame, **NO_TICKS)
        assert natnet.decode(data, version) == kept

    check()


@pytest.mark.parametrize("version", RICH)
def test_every_truncation_is_refused_or_read(version):
    info = natnet.ServerInfo("S", (1, 0, 0, 0), (*version, 0, 0), 1000)
    made = [natnet.encode(each, version) for each in (info, natnet.EchoResponse(1, 2))]
    for data in (*RICH[version].values(), *made):
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
