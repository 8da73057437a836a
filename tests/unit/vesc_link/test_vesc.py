import dataclasses
import itertools
import math

import pytest

from steerd.vesc_link import commands as c
from steerd.vesc_link import events as e
from steerd.vesc_link import identity as i
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.commands import Command
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.ids import FW_3_00, FW_5_03, FW_7_01, PROFILES, CommandId, Firmware, knows
from steerd.vesc_link.packets import Reply, decode_command, encode_command, encode_reply
from steerd.vesc_link.scaling import F1TENTH
from steerd.vesc_link.session_limits import limits_hold, make_restored_limits, make_session_limits
from steerd.vesc_link.vesc import CONNECT_TRIES, EXPIRY_NS, POLL_EXPIRY_NS, WRITE_LIMIT, VescLink

MS = 1_000_000
UUID = bytes(range(12))
LIMITS = i.McConfTemp(1, 1, -23250, 23250, 0.005, 0.95, -1500, 1500, -20, 40, 4, 11.8, 0.1)
VALUES = t.Values(erpm=4614.0, tachometer_abs=1000, fault=0, status=0)
DRIVE = e.DriveSpeed(steer=0.1, speed=1.0)


class Vesc:
    """Just enough of a VESC to answer a client, frame by frame."""

    def __init__(self, firmware: Firmware = FW_7_01) -> None:
        self.firmware = firmware
        self.values = VALUES
        self.uptime_ms = 5000
        self.limits = LIMITS
        self.appconf = i.AppConf(1, 7, 200, 8.0, bytes(420))
        self.seen: list[Command] = []
        self._parser = FrameParser(strict=True)

    def answer(self, data: bytes) -> bytes:
        replies = []
        for payload in self._parser.feed(data, 0):
            command = decode_command(payload, self.firmware)
            assert command is not None, payload.hex()
            self.seen.append(command)
            replies.append(self._reply(command))
        return b"".join(
            encode_frame(encode_reply(reply, self.firmware)) for reply in replies if reply
        )

    def _reply(self, command: Command) -> Reply | None:
        match command:
            case c.GetFwVersion():
                return i.FwVersion(*self.firmware, "60_MK6", UUID)
            case c.GetAppConf():
                return self.appconf
            case c.GetMcConfTemp():
                return self.limits
            case c.GetValues():
                return self.values
            case c.GetValuesSelective(mask=mask):
                return dataclasses.replace(self.values, mask=mask)
            case c.GetValuesSetupSelective(mask=mask):
                return t.ValuesSetup(uptime_ms=self.uptime_ms, mask=mask)
            case c.GetImuData(mask=mask):
                return t.Imu(mask, accel_x=0.0, accel_y=0.0, accel_z=9.80665, gyro_z=0.5)
            case c.SetMcConfTemp():
                return i.Ack(CommandId.SET_MCCONF_TEMP)
            case _:
                return None


def connect(link: VescLink, vesc: Vesc, t_ns: int = 0) -> list[e.Event]:
    events: list[e.Event] = []
    for step in range(10):
        if link.ready:
            break
        now = t_ns + step * MS
        events += link.on_bytes(now, vesc.answer(link.make_connect(now)))
    assert link.ready
    vesc.seen.clear()
    return events


@pytest.fixture
def vesc() -> Vesc:
    return Vesc()


@pytest.fixture
def link(vesc: Vesc) -> VescLink:
    made = VescLink(F1TENTH, imu_mask=t.IMU_ACCEL_GYRO_MASK)
    connect(made, vesc)
    return made


def kinds(events: list[e.Event]) -> list[type[e.Event]]:
    return [type(event) for event in events]


def test_connect_reads_who_it_is_and_how_it_is_set(vesc: Vesc) -> None:
    link = VescLink(F1TENTH, expected_uuid=UUID)
    events = connect(link, vesc)
    assert kinds(events) == [e.Identity, e.AppConfRead, e.LimitsRead]
    assert isinstance(events[0], e.Identity)
    assert events[0].expected
    assert link.firmware == FW_7_01
    assert link.appconf == vesc.appconf
    assert link.limits is not None
    assert link.limits.erpm_max == 23250
    assert link.make_connect(10**9) == b""


def test_wrong_uuid_is_reported(vesc: Vesc) -> None:
    link = VescLink(F1TENTH, expected_uuid=bytes(12))
    identity = connect(link, vesc)[0]
    assert isinstance(identity, e.Identity)
    assert not identity.expected


@pytest.mark.parametrize("firmware", [Firmware(2, 18), *PROFILES], ids=str)
def test_connect_and_drive_with_every_firmware(firmware: Firmware) -> None:
    vesc = Vesc(firmware)
    link = VescLink(F1TENTH, imu_mask=t.IMU_ACCEL_GYRO_MASK)
    connect(link, vesc)
    assert (link.appconf is not None) == (firmware >= (3, 55))
    assert (link.limits is not None) == knows(firmware, CommandId.GET_MCCONF_TEMP)
    events = link.on_bytes(2 * MS, vesc.answer(link.make_tick(DRIVE, MS)))
    assert c.SetErpm(4614.0) in vesc.seen
    assert [s for s in vesc.seen if isinstance(s, c.SetServoPos)] == [c.SetServoPos(0.409)]
    telemetry = events[0]
    assert isinstance(telemetry, e.Telemetry)
    assert telemetry.values.erpm == 4614.0
    assert (e.ImuSample in kinds(events)) == (firmware >= (3, 52))
    assert (e.Uptime in kinds(events)) == (firmware >= FW_5_03)
    assert link.counters == type(link.counters)()


def test_connect_asks_again_after_silence_and_goes_on_without_configuration(vesc: Vesc) -> None:
    link = VescLink(F1TENTH)
    assert link.make_connect(0) == encode_frame(b"\0")
    assert link.make_connect(EXPIRY_NS) == b""
    assert link.make_connect(EXPIRY_NS + 1) == encode_frame(b"\0")
    link.on_bytes(EXPIRY_NS + 2, vesc.answer(encode_frame(b"\0")))
    requested = []
    for n in range(2, 40):
        requested.append(link.make_connect(n * 100 * MS))
        link.on_bytes(n * 100 * MS, b"")
    assert requested.count(encode_frame(b"\x11")) == CONNECT_TRIES
    assert requested.count(encode_frame(b"\x5b")) == CONNECT_TRIES
    assert link.ready
    assert link.appconf is None


def test_one_tick_is_one_write_of_one_usb_packet(link: VescLink, vesc: Vesc) -> None:
    data = link.make_tick(DRIVE, 0)
    assert len(data) <= WRITE_LIMIT
    vesc.answer(data)
    assert vesc.seen == [
        c.SetErpm(4614.0),
        c.SetServoPos(0.409),
        c.GetValuesSelective(t.FAST_MASK),
        c.GetImuData(t.IMU_ACCEL_GYRO_MASK),
        c.GetValuesSetupSelective(t.UPTIME_MASK),
    ]


@pytest.mark.parametrize(
    ("drive", "motion"),
    [
        (e.DriveBrake(None, 8.0), [c.SetCurrentBrake(8.0)]),
        (e.DriveBrake(0.0, 8.0), [c.SetCurrentBrake(8.0), c.SetServoPos(0.53)]),
        (e.DriveShort(None), [c.SetDuty(0.0)]),
        (e.DriveRelease(), [c.SetCurrent(0.0)]),
        (e.DriveSilent(), []),
        (e.DriveSilent(steer=0.0), [c.SetServoPos(0.53)]),
        (e.DriveSpeed(9.0, 99.0), [c.SetErpm(23250.0), c.SetServoPos(0.15)]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_drive_orders(link: VescLink, vesc: Vesc, drive: e.Drive, motion: list[Command]) -> None:
    vesc.answer(link.make_tick(drive, 0))
    assert [s for s in vesc.seen if not type(s).__name__.startswith("Get")] == motion


def test_braking_needs_no_identity(vesc: Vesc) -> None:
    link = VescLink(F1TENTH)
    vesc.answer(link.make_tick(e.DriveBrake(None, 5.0), 0))
    assert vesc.seen == [c.SetCurrentBrake(5.0)]


@pytest.mark.parametrize(
    "drive",
    [
        e.DriveSpeed(math.nan, 1.0),
        e.DriveSpeed(0.0, math.nan),
        e.DriveSpeed(0.0, math.inf),
        e.DriveBrake(0.0, math.nan),
        e.DriveBrake(math.inf, 1.0),
    ],
)
def test_order_that_is_no_number_sends_nothing_and_leaves_polls_open(
    link: VescLink, vesc: Vesc, drive: e.Drive
) -> None:
    with pytest.raises(ValueError, match=r"no command|cannot be sent"):
        link.make_tick(drive, 0)
    events = link.on_bytes(MS, vesc.answer(link.make_tick(e.DriveBrake(None, 5.0), 0)))
    assert e.Telemetry in kinds(events)


def test_nothing_ever_sends_alive(link: VescLink, vesc: Vesc) -> None:
    drives = (DRIVE, e.DriveBrake(None, 1.0), e.DriveSilent(), e.DriveRelease())
    for n, drive in zip(range(600), itertools.cycle(drives), strict=False):
        link.on_bytes(n * 5 * MS, vesc.answer(link.make_tick(drive, n * 5 * MS)))
    assert len(vesc.seen) > 1000
    assert not any(isinstance(command, c.Alive) for command in vesc.seen)


def test_reply_carries_send_and_first_byte_stamps(link: VescLink, vesc: Vesc) -> None:
    reply = vesc.answer(link.make_tick(DRIVE, 10 * MS))
    assert link.on_bytes(11 * MS, reply[:1]) == []
    events = link.on_bytes(13 * MS, reply[1:])
    telemetry = events[0]
    assert isinstance(telemetry, e.Telemetry)
    assert telemetry.when == e.Stamped(10 * MS, 11 * MS)
    assert telemetry.when.stamp_ns == 10 * MS + MS // 2
    assert isinstance(events[1], e.ImuSample)
    assert events[1].when == e.Stamped(10 * MS, 13 * MS)


def test_one_request_per_id_until_answered_or_expired(link: VescLink, vesc: Vesc) -> None:
    link.make_tick(e.DriveSilent(), 0)
    for t_ns in (5 * MS, POLL_EXPIRY_NS):
        assert link.make_tick(e.DriveSilent(), t_ns) == b""
    assert kinds(link.on_bytes(POLL_EXPIRY_NS + 1, b"")) == [e.Expired] * 3
    vesc.answer(link.make_tick(e.DriveSilent(), POLL_EXPIRY_NS + 2))
    assert vesc.seen == [
        c.GetValuesSelective(t.FAST_MASK),
        c.GetImuData(t.IMU_ACCEL_GYRO_MASK),
    ]
    assert link.counters.expired == 3


def test_polls_that_went_lost_are_repeated_five_times_in_100_ms(link: VescLink) -> None:
    sent = [bool(link.make_tick(e.DriveSilent(), t_ms * MS)) for t_ms in range(0, 100, 10)]
    assert sent == [True, False] * 5


def test_a_reply_after_several_repeats_may_answer_the_first_of_them(
    link: VescLink, vesc: Vesc
) -> None:
    first = vesc.answer(link.make_tick(e.DriveSilent(), 0))
    for t_ms in (20, 40, 60):
        link.make_tick(e.DriveSilent(), t_ms * MS)
    telemetry = next(ev for ev in link.on_bytes(61 * MS, first) if isinstance(ev, e.Telemetry))
    assert telemetry.when == e.Stamped(0, 61 * MS)


def test_late_reply_keeps_its_true_interval(link: VescLink, vesc: Vesc) -> None:
    late = vesc.answer(link.make_tick(e.DriveSilent(), 0))
    link.on_bytes(81 * MS, b"")
    second = vesc.answer(link.make_tick(e.DriveSilent(), 82 * MS))
    telemetry = next(ev for ev in link.on_bytes(83 * MS, late) if isinstance(ev, e.Telemetry))
    assert telemetry.when == e.Stamped(0, 83 * MS)
    strays = link.on_bytes(84 * MS, second)
    assert kinds(strays) == [e.Unknown] * 2
    assert link.counters.unsolicited == 2 + 1  # the late uptime reply as well
    third = vesc.answer(link.make_tick(e.DriveSilent(), 90 * MS))
    telemetry = next(ev for ev in link.on_bytes(91 * MS, third) if isinstance(ev, e.Telemetry))
    assert telemetry.when == e.Stamped(90 * MS, 91 * MS)


def test_interval_is_not_widened_by_what_expired_long_ago(link: VescLink, vesc: Vesc) -> None:
    link.make_tick(e.DriveSilent(), 0)
    link.on_bytes(81 * MS, b"")
    later = vesc.answer(link.make_tick(e.DriveSilent(), 5000 * MS))
    telemetry = link.on_bytes(5001 * MS, later)[0]
    assert isinstance(telemetry, e.Telemetry)
    assert telemetry.when == e.Stamped(5000 * MS, 5001 * MS)


def test_reply_with_another_mask_is_not_ours(link: VescLink) -> None:
    link.make_tick(e.DriveSilent(), 0)
    other = encode_frame(encode_reply(dataclasses.replace(VALUES, mask=0x180)))
    events = link.on_bytes(MS, other)
    assert isinstance(events[0], e.Unknown)
    assert (events[0].reason, events[0].command) == ("not requested", 50)
    assert link.counters.unsolicited == 1


@pytest.mark.parametrize("size", [42, 50, 56])
def test_telemetry_shorter_than_the_firmware_sends_is_refused(link: VescLink, size: int) -> None:
    link.make_tick(e.DriveSilent(), 0)
    payload = encode_reply(dataclasses.replace(VALUES, mask=t.FAST_MASK))
    whole = encode_frame((payload + bytes(9))[:size])
    events = link.on_bytes(MS, whole)
    assert kinds(events) == ([e.Telemetry] if size >= 51 else [e.Unknown])
    assert link.counters.odd_lengths == (size < 51)


def test_old_firmware_accepts_its_own_table_alone() -> None:
    link, vesc = VescLink(F1TENTH), Vesc(FW_3_00)
    connect(link, vesc)
    link.make_tick(e.DriveSilent(), 0)
    new_table = encode_frame(encode_reply(VALUES, FW_7_01))
    assert kinds(link.on_bytes(MS, new_table)) == [e.Unknown]


def test_short_imu_reply_is_refused(link: VescLink) -> None:
    link.make_tick(e.DriveSilent(), 0)
    payload = encode_reply(t.Imu(t.IMU_ACCEL_GYRO_MASK))
    assert kinds(link.on_bytes(MS, encode_frame(payload[:-5]))) == [e.Unknown]


def test_unsolicited_frames_are_counted_apart(link: VescLink) -> None:
    frames = [b"\x15hello", b"\x16\0\0\0\0", b"\x24abc", b"\xfa\1", b"\x00\x07"]
    events = link.on_bytes(MS, b"".join(map(encode_frame, frames)))
    assert events[0] == e.Printed("hello", MS)
    assert [event.reason for event in events[1:] if isinstance(event, e.Unknown)] == [
        "unsolicited",
        "unsolicited",
        "unknown id",
        "wrong length for this firmware",
    ]
    assert link.counters.unknown_ids == 1


def test_a_fault_is_said_once_for_as_long_as_it_lasts(link: VescLink, vesc: Vesc) -> None:
    def tick(n: int, fault: int) -> list[e.Event]:
        vesc.values = dataclasses.replace(VALUES, fault=fault)
        return link.on_bytes(n * MS, vesc.answer(link.make_tick(DRIVE, n * MS)))

    assert e.FaultSeen not in kinds(tick(1, 0))
    seen = [event for event in tick(2, 2) if isinstance(event, e.FaultSeen)]
    assert seen == [e.FaultSeen(2, "UNDER_VOLTAGE", 2 * MS)]
    assert e.FaultSeen not in kinds(tick(3, 2))
    assert e.FaultSeen in kinds(tick(4, 5)), "another one"
    assert e.FaultSeen not in kinds(tick(5, 0))
    assert e.FaultSeen in kinds(tick(6, 5)), "again"


def test_restart_is_seen_by_uptime_tachometer_and_watchdog_fault(
    link: VescLink, vesc: Vesc
) -> None:
    def reasons(n: int) -> list[str]:
        events = link.on_bytes(n, vesc.answer(link.make_tick(DRIVE, n)))
        return [event.reason for event in events if isinstance(event, e.Rebooted)]

    assert reasons(0) == []
    vesc.uptime_ms = 10
    assert reasons(10**9) == ["its uptime went back"]
    assert reasons(2 * 10**9) == []
    vesc.values = dataclasses.replace(VALUES, tachometer_abs=3)
    assert reasons(3 * 10**9) == ["its tachometer went back"]
    vesc.values = dataclasses.replace(VALUES, tachometer_abs=4, fault=10)
    assert reasons(4 * 10**9) == ["its watchdog restarted it"]
    assert link.limits is None
    assert not link.ready


def test_uptime_is_requested_once_a_second(link: VescLink, vesc: Vesc) -> None:
    for n in range(1000):
        t_ns = n * 5 * MS
        vesc.uptime_ms += 5
        link.on_bytes(t_ns + MS, vesc.answer(link.make_tick(DRIVE, t_ns)))
    assert sum(isinstance(s, c.GetValuesSetupSelective) for s in vesc.seen) == 5
    assert sum(isinstance(s, c.GetValuesSelective) for s in vesc.seen) == 1000


def test_requests_go_out_when_there_is_room(link: VescLink, vesc: Vesc) -> None:
    assert link.limits is not None
    limits = make_session_limits(link.limits, erpm_max=9228.0, current_scale=0.5)
    link.request(limits)
    link.request(c.GetMcConfTemp())
    data = link.make_tick(DRIVE, 0)
    assert len(data) <= WRITE_LIMIT
    link.on_bytes(0, vesc.answer(data))
    assert not any(isinstance(s, c.SetMcConfTemp) for s in vesc.seen)
    data = link.make_tick(e.DriveSilent(), 5 * MS)
    assert len(data) <= WRITE_LIMIT
    events = link.on_bytes(6 * MS, vesc.answer(data))
    assert kinds(events) == [e.Answer, e.Telemetry]
    sent = next(s for s in vesc.seen if isinstance(s, c.SetMcConfTemp))
    assert (sent.store, sent.ack, sent.erpm_min, sent.erpm_max) == (False, True, -9228, 9228)
    vesc.limits = dataclasses.replace(vesc.limits, erpm_min=-9228, erpm_max=9228)
    vesc.limits = dataclasses.replace(vesc.limits, current_max_scale=0.5)
    events = link.on_bytes(11 * MS, vesc.answer(link.make_tick(DRIVE, 10 * MS)))
    read = next(event for event in events if isinstance(event, e.LimitsRead))
    assert limits_hold(limits, read.limits)
    assert not limits_hold(make_restored_limits(LIMITS), read.limits)


@pytest.mark.parametrize(
    "command",
    [c.SetErpm(0.0), c.Alive(), c.SetServoPos(0.5), c.Reboot(), c.ForwardCan(1, b"\x08"),
     c.SetDetect(1), c.GetMcConf()],
)  # fmt: skip
def test_what_drives_is_not_sent_on_request(link: VescLink, command: Command) -> None:
    with pytest.raises(ValueError, match="not sent on request"):
        link.request(command)


def test_session_limits_only_ever_tighten() -> None:
    wide = make_session_limits(LIMITS, erpm_max=1e6, current_scale=1.0, duty_max=1.0)
    assert wide == make_restored_limits(LIMITS)
    tight = make_session_limits(LIMITS, erpm_max=5000, current_scale=0.2, duty_max=0.5)
    assert (tight.erpm_min, tight.erpm_max) == (-5000, 5000)
    assert (tight.current_min_scale, tight.current_max_scale) == (1, 0.2)
    assert tight.duty_max == 0.5
    assert tight.watt_max == 1500
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="positive and finite"):
            make_session_limits(LIMITS, erpm_max=wrong)


def test_long_configuration_passes_the_running_ceiling_only_when_requested(
    link: VescLink, vesc: Vesc
) -> None:
    stray = encode_frame(encode_reply(vesc.appconf))
    assert link.on_bytes(0, stray + bytes(600)) == []
    link.request(c.GetAppConf())
    events = link.on_bytes(MS, vesc.answer(link.make_tick(DRIVE, MS)))
    assert e.AppConfRead in kinds(events)


def test_reset_forgets_the_device_and_its_fault(link: VescLink, vesc: Vesc) -> None:
    vesc.values = dataclasses.replace(VALUES, fault=5)
    link.on_bytes(MS, vesc.answer(link.make_tick(DRIVE, 0)))
    link.reset()
    assert (link.version, link.limits, link.ready) == (None, None, False)
    connect(link, vesc, 10 * MS)
    events = link.on_bytes(500 * MS, vesc.answer(link.make_tick(DRIVE, 500 * MS)))
    assert e.FaultSeen in kinds(events)


def test_corrupted_bytes_give_no_event(link: VescLink, vesc: Vesc) -> None:
    reply = bytearray(vesc.answer(link.make_tick(e.DriveSilent(), 0))[:56])
    for at in range(2, len(reply)):
        reply[at] ^= 0x10
        fresh = link.on_bytes(at, bytes(reply))
        assert e.Telemetry not in kinds(fresh)
        reply[at] ^= 0x10
    assert link.parser.crc_errors >= 54
    assert e.Telemetry in kinds(link.on_bytes(57, bytes(600) + bytes(reply)))


def test_request_for_a_firmware_that_cannot_is_refused_at_once() -> None:
    link, vesc = VescLink(F1TENTH), Vesc(Firmware(3, 40))
    connect(link, vesc)
    with pytest.raises(ValueError, match="needs firmware"):
        link.request(c.GetBatteryCut())
    assert encode_command(c.GetBatteryCut())
