import binascii

import pytest

from steerd.vesc_link.frames import FLUSH, HOST_GAP_NS, Frame, FrameParser, encode_frame

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


def test_low_ceiling_ends_head_of_line_blocking_and_never_exceeds_the_buffer():
    assert FrameParser(max_payload=128, strict=True).feed(b"\x03\x02\x00" + RPM, 0) == [RPM[2:-3]]
    assert FrameParser(strict=True).feed(b"\x03\x02\x00" + RPM, 0) == []
    parser = FrameParser(max_payload=64)
    parser.ceiling = 512
    assert parser.feed(encode_frame(bytes(65)), 0) == []
    assert parser.buffered <= 1


def test_zero_flush_frees_the_firmware_whatever_was_half_sent():
    cut = encode_frame(bytes(500))[:-1]
    for stray in (b"\x03\x02\x00", b"\x02", b"\x02\xff", b"\x03\x01", cut):
        parser = FrameParser(strict=True)
        assert parser.feed(stray, 0) == []
        assert parser.feed(FLUSH, 0) == []
        assert parser.feed(RPM, 0) == [RPM[2:-3]]


def test_outer_frame_wins_over_one_inside_it():
    outer = encode_frame(b"\x15" + SERVO + b"tail")
    for strict in (True, False):
        assert FrameParser(strict=strict).feed(outer + RPM, 0) == [outer[2:-3], RPM[2:-3]]


def test_host_takes_a_good_frame_out_of_a_false_header():
    parser = FrameParser()
    assert parser.feed(b"\x03\x01\xff" + RPM[:4], 0) == []
    assert parser.feed(RPM[4:] + SERVO[:3], 1) == [RPM[2:-3]]
    assert parser.dropped_bytes == 3
    assert parser.feed(SERVO[3:], 2) == [SERVO[2:-3]]
    assert parser.buffered == 0


@pytest.mark.parametrize(
    ("begun", "late", "dropped"), [(RPM[:5], b"\0", 6), (b"\x03", b"\x01", 1), (RPM[:5], b"", 5)]
)
def test_stale_prefix_is_dropped_after_a_gap(begun, late, dropped):
    parser = FrameParser()
    assert parser.feed(begun, 0) == []
    assert parser.feed(late, LATE) == []
    assert parser.dropped_bytes == dropped
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


def test_header_bytes_inside_an_arriving_frame_are_no_line_errors():
    frame = encode_frame(bytes((0x32, 2, 1, 2, 2, 2, 2, 3, 3, 3, 3, 2, 1, 0, 0, 3)))
    parser = FrameParser()
    for byte in frame:
        parser.feed(bytes((byte,)), 0)
    assert (parser.frames, parser.crc_errors, parser.dropped_bytes) == (1, 0, 0)


def test_line_errors_are_counted_once():
    broken = bytearray(RPM)
    broken[4] ^= 1
    parser = FrameParser()
    parser.feed(bytes(broken) + RPM, 0)
    assert (parser.frames, parser.crc_errors, parser.dropped_bytes) == (1, 1, 10)


class CountedChecksum:
    """Fails every frame and counts the checks: work, measured without a clock."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, data: bytes, start: int) -> int:
        self.calls += 1
        return 0xFFFF


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("chunk", [1, 64, 20_000])
@pytest.mark.parametrize(
    "storm", [b"\x02\xff", b"\x02\x03", b"\x02\x02", b"\x03\x01\xff", b"\x02\x80\x03"]
)
def test_header_storm_costs_one_check_per_byte_at_most(storm, chunk, strict, monkeypatch):
    counted = CountedChecksum()
    monkeypatch.setattr(binascii, "crc_hqx", counted)
    data = (storm * 20_000)[:20_000]
    parser = FrameParser(strict=strict)
    for at in range(0, len(data), chunk):
        assert parser.feed(data[at : at + chunk], at) == []
        assert parser.buffered <= 518
    assert counted.calls <= len(data)
