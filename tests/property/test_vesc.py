"""VESC frames and packets: any bytes, any chunks, any damage, any numbers."""

import binascii
import dataclasses
import itertools
import math

from hypothesis import example, given, settings
from hypothesis import strategies as st

from steerd.vesc_link import commands as c
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.ids import PROFILES, Firmware
from steerd.vesc_link.packets import decode_command, decode_reply, encode_command, encode_reply

CHECKED = settings(derandomize=True, deadline=None, database=None, max_examples=200)
PAYLOADS = st.binary(min_size=1, max_size=60) | st.binary(min_size=250, max_size=512)
SOUP = st.lists(
    st.sampled_from([b"\x02", b"\x03", b"\x02\x01", b"\x03\x01\xff", b"\x03\x02\x00", b"\0"])
    | st.binary(max_size=40)
    | PAYLOADS.map(encode_frame)
    | PAYLOADS.map(lambda payload: encode_frame(payload)[:-2]),
    max_size=12,
).map(b"".join)
CUTS = st.lists(st.integers(0, 2000), max_size=20)


def chunks(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


def firmware_reference(data: bytes) -> list[tuple[int, bytes]]:
    """The receiver of `docs/reference/vesc-serial.md#v1.5`: (bytes read so far, payload)."""
    found: list[tuple[int, bytes]] = []
    buffer = b""
    for count, byte in enumerate(data, 1):
        buffer += bytes((byte,))
        while buffer:
            step, payload = firmware_step(buffer)
            if step == 0:
                break
            if payload is not None:
                found.append((count, payload))
            buffer = buffer[step:]
    return found


def firmware_step(buffer: bytes) -> tuple[int, bytes | None]:
    kind = buffer[0]
    if kind not in (2, 3):
        return 1, None
    if len(buffer) < kind:
        return 0, None
    size = buffer[1] if kind == 2 else 256 * buffer[1] + buffer[2]
    if size < (1 if kind == 2 else 255) or size > 512:
        return 1, None
    total = kind + size + 3
    if len(buffer) < total:
        return 0, None
    payload, tail = buffer[kind : kind + size], buffer[kind + size : total]
    if tail[2] != 3 or tail[:2] != binascii.crc_hqx(payload, 0).to_bytes(2, "big"):
        return 1, None
    return total, payload


@given(SOUP)
@CHECKED
@example(b"\x02\x05\x08\x00\x00\x12\x02\x03\x0c\x01\xf4\xe9\xcb\x03")
def test_strict_parser_is_the_firmware_byte_for_byte(data):
    parser = FrameParser(strict=True)
    got = [(n, p) for n, byte in enumerate(data, 1) for p in parser.feed(bytes((byte,)), 0)]
    assert got == firmware_reference(data)


@given(st.lists(PAYLOADS, max_size=6), CUTS)
@CHECKED
def test_host_parser_gives_the_same_packets_for_any_chunks(payloads, cuts):
    parser = FrameParser()
    data = b"".join(map(encode_frame, payloads))
    assert [p for chunk in chunks(data, cuts) for p in parser.feed(chunk, 0)] == payloads
    assert (parser.dropped_bytes, parser.crc_errors, parser.buffered) == (0, 0, 0)


READS = st.lists(
    st.tuples(
        st.lists(PAYLOADS.map(encode_frame), max_size=3).map(b"".join) | SOUP,
        st.sampled_from([1_000_000, 20_000_000, 2_000_000_000]),
    ),
    max_size=8,
)


@CHECKED
@given(READS, st.booleans(), st.sampled_from([None, 1_000_000_000]), st.integers(100, 512))
def test_reads_of_whole_frames_are_what_the_general_way_makes_of_them(
    reads, strict, gap_ns, ceiling
):
    one, general = (FrameParser(strict=strict, gap_ns=gap_ns) for _ in range(2))
    general._take_whole = lambda data, t_ns: None  # type: ignore[method-assign]
    one.ceiling = general.ceiling = ceiling
    t_ns = 0
    for data, pause_ns in reads:
        t_ns += pause_ns
        assert one.feed_stamped(data, t_ns) == general.feed_stamped(data, t_ns)
        for count in ("frames", "crc_errors", "dropped_bytes", "buffered"):
            assert getattr(one, count) == getattr(general, count)


@given(SOUP, PAYLOADS)
@CHECKED
def test_good_frame_behind_any_garbage_is_found_at_once_by_the_host(garbage, payload):
    """At once but for one case: the garbage is a frame's beginning and eats this one's start."""
    parser = FrameParser()
    parser.feed(garbage, 0)
    frame = encode_frame(payload)
    assert payload in parser.feed(frame, 1) or payload in parser.feed(frame, 2)


@given(PAYLOADS, st.data())
@CHECKED
def test_any_truncation_delivers_nothing_and_any_flip_is_noticed(payload, data):
    frame = encode_frame(payload)
    cut = data.draw(st.integers(0, len(frame) - 1))
    assert payload not in FrameParser().feed(frame[:cut], 0)
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    broken = bytearray(frame)
    broken[bit // 8] ^= 1 << bit % 8
    assert payload not in FrameParser(strict=True).feed(bytes(broken), 0)


# Properties of VESC packets and the client: any numbers, any payload, any bytes.

FIRMWARE = st.sampled_from((Firmware(2, 18), *PROFILES))
SINGLE = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(
    st.sampled_from(
        [(c.SetDuty, 1e5), (c.SetCurrent, 1e3), (c.SetCurrentBrake, 1e3), (c.SetErpm, 1e0)]
    ),
    st.integers(-(2**31), 2**31 - 1),
)  # fmt: skip
@CHECKED
def test_every_wire_value_of_a_setpoint_survives_decode_and_encode(kind, count):
    command = kind[0](count / kind[1])
    payload = encode_command(command)
    assert int.from_bytes(payload[1:], "big", signed=True) == count
    assert decode_command(payload) == command


@given(st.floats(-1e6, 1e6))
@CHECKED
def test_setpoint_is_off_by_half_a_count_at_most(current):
    sent = decode_command(encode_command(c.SetCurrentBrake(current)))
    assert isinstance(sent, c.SetCurrentBrake)
    assert abs(sent.current - current) <= 0.5e-3 * (1 + 1e-9)


@given(st.floats(-3000, 3000), st.floats(-1e5, 1e5), st.integers(-(2**31), 2**31 - 1), FIRMWARE)
@CHECKED
def test_telemetry_is_off_by_one_count_or_single_precision(current, erpm, tachometer, firmware):
    sent = t.Values(motor_current=current, erpm=erpm, tachometer=tachometer)
    got = decode_reply(encode_reply(sent, firmware), firmware)
    assert isinstance(got, t.Values)
    assert got.tachometer == tachometer
    assert abs(got.motor_current - current) <= 0.01 + abs(current) * 2**-22
    assert abs(got.motor_current) <= abs(current) * (1 + 2**-22)
    assert abs(got.erpm - erpm) <= 1


@given(st.integers(0, 0xFFFFFFFF), st.sampled_from([fw for fw in PROFILES if fw >= (3, 48)]))
@CHECKED
def test_any_mask_is_answered_in_bit_order(mask, firmware):
    payload = encode_reply(t.Values(mask=mask, fault=5, controller_id=9, status=3), firmware)
    got = decode_reply(payload, firmware)
    assert isinstance(got, t.Values)
    assert len(payload) == t.values_size(mask, firmware)
    assert got.fault == (5 if mask >> 15 & 1 else None)
    assert got.controller_id == (9 if mask >> 17 & 1 else None)
    assert got.status == (3 if mask >> 21 & 1 and firmware >= (5, 3) else None)
    assert encode_reply(got, firmware) == payload


@given(st.integers(0, 0xFFFF), st.lists(SINGLE, min_size=16, max_size=16))
@CHECKED
def test_imu_in_si_units_survives_the_wire(mask, numbers):
    names = [field.name for field in dataclasses.fields(t.Imu)][1:17]
    small = {name: math.remainder(n, 1e6) for name, n in zip(names, numbers, strict=True)}
    got = decode_reply(encode_reply(t.Imu(mask, **small)))  # type: ignore[arg-type]
    assert isinstance(got, t.Imu)
    for bit, name in enumerate(names):
        value = getattr(got, name)
        if mask >> bit & 1:
            assert math.isclose(value, small[name], rel_tol=2e-7, abs_tol=1e-36)
        else:
            assert value is None
