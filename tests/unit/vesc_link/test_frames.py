import binascii
import itertools

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from steerd.vesc_link import commands as c
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.frames import FLUSH, HOST_GAP_NS, Frame, FrameParser, encode_frame
from steerd.vesc_link.ids import PROFILES
from steerd.vesc_link.packets import decode_command, decode_reply, encode_command, encode_reply

RPM = encode_frame(bytes.fromhex("0800001206"))
SERVO = encode_frame(bytes.fromhex("0c01f4"))
LATE = HOST_GAP_NS + 1


@pytest.mark.parametrize("size", [0, 513])
def test_payload_that_no_firmware_takes_is_refused(size):
    with pytest.raises(ValueError, match="1 to 512 bytes"):
        encode_frame(bytes(size))


@pytest.mark.parametrize(("size", "accepted"), [(128, True), (129, False)])
def test_ceiling_can_change_between_reads(size, accepted):
    parser = FrameParser()
    parser.ceiling = 128
    assert bool(parser.feed(encode_frame(bytes(size)), 0)) is accepted
    assert parser.buffered <= 1  # a stop byte may be a start byte
    parser.ceiling = 512
    assert parser.feed(encode_frame(bytes(300)), 1) == [bytes(300)]


def test_zero_flush_frees_the_firmware_whatever_was_half_sent():
    cut = encode_frame(bytes(500))[:-1]
    for stray in (b"\x03\x02\x00", b"\x02", b"\x02\xff", b"\x03\x01", cut):
        parser = FrameParser(strict=True)
        assert parser.feed(stray, 0) == []
        assert parser.feed(FLUSH, 0) == []
        assert parser.feed(RPM, 0) == [RPM[2:-3]]


@pytest.mark.parametrize(("begun", "late"), [(RPM[:5], b"\0"), (b"\x03", b"\x01"), (RPM[:5], b"")])
def test_stale_prefix_is_dropped_after_a_gap(begun, late):
    parser = FrameParser()
    assert parser.feed(begun, 0) == []
    assert parser.feed(late, LATE) == []
    assert parser.feed(RPM, LATE + 1) == [RPM[2:-3]]


@pytest.mark.parametrize(("rest", "t_ns"), [(RPM[5:], LATE), (b"", HOST_GAP_NS)])
def test_gap_of_the_host_itself_loses_nothing(rest, t_ns):
    parser = FrameParser()
    assert parser.feed(RPM[:5], 0) == []
    assert [*parser.feed(rest, t_ns), *parser.feed(RPM[5 + len(rest) :], t_ns)] == [RPM[2:-3]]


def test_old_firmware_forgets_everything_after_a_second():
    new, old = FrameParser(strict=True), FrameParser(strict=True, gap_ns=10**9)
    for parser, payloads in ((new, []), (old, [RPM[2:-3]])):
        parser.feed(b"\x03\x02\x00", 0)
        assert parser.feed(RPM, 2 * 10**9) == payloads


def test_frame_is_stamped_with_the_read_of_its_first_byte():
    parser = FrameParser()
    assert parser.feed_stamped(b"\x00" + RPM[:1], 100) == []
    assert parser.feed_stamped(RPM[1:7], 200) == []
    stamped = parser.feed_stamped(RPM[7:] + SERVO + RPM[:4], 300)
    assert stamped == [Frame(RPM[2:-3], 100), Frame(SERVO[2:-3], 300)]
    assert parser.feed_stamped(RPM[4:], 400) == [Frame(RPM[2:-3], 300)]


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("chunk", [1, 64, 20_000])
@pytest.mark.parametrize(
    "storm", [b"\x02\xff", b"\x02\x03", b"\x02\x02", b"\x03\x01\xff", b"\x02\x80\x03"]
)
def test_header_storm_costs_one_check_per_byte_at_most(storm, chunk, strict, monkeypatch):
    checks: list[int] = []  # each fails; their number is work, measured without a clock
    monkeypatch.setattr(binascii, "crc_hqx", lambda _, start: checks.append(start) or 0xFFFF)
    data = (storm * 20_000)[:20_000]
    parser = FrameParser(strict=strict)
    for at in range(0, len(data), chunk):
        assert parser.feed(data[at : at + chunk], at) == []
        assert parser.buffered <= 518
    assert len(checks) <= len(data)


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


def firmware_reference(data: bytes):
    """The receiver of `docs/reference/vesc-serial.md#v1.5`: (bytes read so far, payload)."""
    buffer = b""
    for count, byte in enumerate(data, 1):
        buffer += bytes((byte,))
        while buffer and (step := firmware_step(buffer))[0]:
            if step[1] is not None:
                yield count, step[1]
            buffer = buffer[step[0] :]


def firmware_step(buffer: bytes) -> tuple[int, bytes | None]:
    """How many bytes are done with, and the payload that ended with them."""
    kind = buffer[0]
    if kind not in (2, 3):
        return 1, None
    if len(buffer) < kind:
        return 0, None
    size = int.from_bytes(buffer[1:kind], "big")
    if size < (1 if kind == 2 else 255) or size > 512:
        return 1, None
    total = kind + size + 3
    if len(buffer) < total:
        return 0, None
    payload = buffer[kind : kind + size]
    good = binascii.crc_hqx(payload, 0).to_bytes(2, "big") + b"\3" == buffer[total - 3 : total]
    return (total, payload) if good else (1, None)


@given(SOUP)
@CHECKED
@example(b"\x02\x05\x08\x00\x00\x12\x02\x03\x0c\x01\xf4\xe9\xcb\x03")
def test_strict_parser_is_the_firmware_byte_for_byte(data):
    parser = FrameParser(strict=True)
    got = [(n, p) for n, byte in enumerate(data, 1) for p in parser.feed(bytes((byte,)), 0)]
    assert got == list(firmware_reference(data))


@given(st.lists(PAYLOADS, max_size=6), CUTS)
@CHECKED
def test_host_parser_gives_the_same_packets_for_any_chunks(payloads, cuts):
    parser = FrameParser()
    data = b"".join(map(encode_frame, payloads))
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    chunks = [data[a:b] for a, b in itertools.pairwise(edges)]
    assert [p for chunk in chunks for p in parser.feed(chunk, 0)] == payloads
    assert parser.buffered == 0


DATA = st.lists(PAYLOADS.map(encode_frame), max_size=3).map(b"".join) | SOUP
PAUSES = st.sampled_from([1_000_000, 20_000_000, 2_000_000_000])
READS = st.lists(st.tuples(DATA, PAUSES), max_size=8)


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
        assert one.buffered == general.buffered


@given(SOUP, PAYLOADS)
@CHECKED
def test_good_frame_behind_any_garbage_is_found_at_once_by_the_host(garbage, payload):
    """At once but for one case: the garbage is a frame's beginning and eats this one's start."""
    parser = FrameParser()
    parser.feed(garbage, 0)
    frame = encode_frame(payload)
    assert payload in parser.feed(frame, 1) or payload in parser.feed(frame, 2)


# Properties of VESC packets and the client: any numbers, any payload, any bytes.
PER_UNIT = {c.SetDuty: 1e5, c.SetCurrent: 1e3, c.SetCurrentBrake: 1e3, c.SetErpm: 1e0}


@given(st.sampled_from([*PER_UNIT]), st.integers(-(2**31), 2**31 - 1))
@CHECKED
def test_every_wire_value_of_a_setpoint_survives_decode_and_encode(kind, count):
    command = kind(count / PER_UNIT[kind])
    payload = encode_command(command)
    assert int.from_bytes(payload[1:], "big", signed=True) == count
    assert decode_command(payload) == command


@given(st.integers(0, 0xFFFFFFFF), st.sampled_from([fw for fw in PROFILES if fw >= (3, 48)]))
@CHECKED
def test_any_mask_is_answered_in_bit_order(mask, firmware):
    payload = encode_reply(t.Values(mask=mask, fault=5, controller_id=9, status=3), firmware)
    got = decode_reply(payload, firmware)
    assert len(payload) == t.values_size(mask, firmware)
    assert got.fault == (5 if mask >> 15 & 1 else None)
    assert got.controller_id == (9 if mask >> 17 & 1 else None)
    assert got.status == (3 if mask >> 21 & 1 and firmware >= (5, 3) else None)
    assert encode_reply(got, firmware) == payload
