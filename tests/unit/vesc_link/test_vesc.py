import dataclasses
import itertools
from collections import Counter
from math import inf, nan

import pytest

from steerd.steer_bus.messages import ActuationMode
from steerd.vesc_link import commands as c
from steerd.vesc_link import identity as i
from steerd.vesc_link import telemetry as t
from steerd.vesc_link import vesc as v
from steerd.vesc_link.commands import Command
from steerd.vesc_link.frames import FrameParser, encode_frame
from steerd.vesc_link.identity import limits_hold, make_restored_limits, make_session_limits
from steerd.vesc_link.ids import FW_3_00, FW_5_03, FW_7_01, PROFILES, CommandId, Firmware, knows
from steerd.vesc_link.packets import Reply, decode_command, encode_command, encode_reply
from steerd.vesc_link.scaling import F1TENTH

MS = 1_000_000
UUID = bytes(range(12))
LIMITS = i.McConfTemp(1, 1, -23250, 23250, 0.005, 0.95, -1500, 1500, -20, 40, 4, 11.8, 0.1)
VALUES = t.Values(erpm=4614.0, tachometer_abs=1000, fault=0, status=0)
DRIVE = v.Drive(ActuationMode.SPEED, steer=0.1, speed=1.0)
SILENT = v.Drive()


def brake(current: float, steer: float | None = None) -> v.Drive:
    return v.Drive(ActuationMode.BRAKE, steer, current=current)


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
        return b"".join(encode_frame(encode_reply(each, self.firmware)) for each in replies if each)

    def _reply(self, command: Command) -> Reply | None:
        mask = getattr(command, "mask", 0)
        return {
            c.GetFwVersion: i.FwVersion(*self.firmware, "60_MK6", UUID),
            c.GetAppConf: self.appconf, c.GetMcConfTemp: self.limits, c.GetValues: self.values,
            c.GetValuesSelective: dataclasses.replace(self.values, mask=mask),
            c.GetValuesSetupSelective: t.Uptime(self.uptime_ms, mask),
            c.GetImuData: t.Imu(mask, accel_x=0.0, accel_y=0.0, accel_z=9.80665, gyro_z=0.5),
            c.SetMcConfTemp: i.Ack(CommandId.SET_MCCONF_TEMP),
        }.get(type(command))  # fmt: skip


def connect(link: v.VescLink, vesc: Vesc, t_ns: int = 0) -> list[v.Event]:
    events: list[v.Event] = []
    while not link.ready:
        assert len(events) < 10
        events += link.on_bytes(t_ns, vesc.answer(link.make_connect(t_ns)))
        t_ns += MS
    vesc.seen.clear()
    return events


vesc = pytest.fixture(lambda: Vesc())


@pytest.fixture
def link(vesc: Vesc) -> v.VescLink:
    made = v.VescLink(F1TENTH)
    connect(made, vesc)
    return made


def tick(link: v.VescLink, vesc: Vesc, t_ns: int, drive: v.Drive = DRIVE) -> list[v.Event]:
    """A tick that is answered a millisecond later."""
    return link.on_bytes(t_ns + MS, vesc.answer(link.make_tick(drive, t_ns)))


def kinds(events: list[v.Event]) -> list[type[Reply | v.Rebooted]]:
    """What was answered, or that it restarted."""
    return [type(event.reply if isinstance(event, v.Answer) else event) for event in events]


def when(event: v.Event) -> tuple[int, int]:
    return event.t_sent_ns, event.t_received_ns


def telemetry_in(events: list[v.Event]) -> v.Answer:
    return next(ev for ev in events if isinstance(ev, v.Answer) and isinstance(ev.reply, t.Values))


@pytest.mark.parametrize("uuid", [UUID, bytes(12)], ids=["expected", "another"])
def test_connect_reads_who_it_is_and_how_it_is_set(vesc, uuid):
    link = v.VescLink(F1TENTH, expected_uuid=uuid)
    events = connect(link, vesc)
    assert kinds(events) == [i.FwVersion, i.AppConf, i.McConfTemp]
    assert link.expected is (uuid == UUID)
    assert (link.firmware, link.appconf, link.limits.erpm_max) == (FW_7_01, vesc.appconf, 23250)
    assert link.make_connect(10**9) == b""


@pytest.mark.parametrize("firmware", [Firmware(2, 18), *PROFILES], ids=str)
def test_connect_and_drive_with_every_firmware(firmware):
    vesc = Vesc(firmware)
    link = v.VescLink(F1TENTH)
    connect(link, vesc)
    assert (link.appconf is not None) == (firmware >= (3, 55))
    assert (link.limits is not None) == knows(firmware, CommandId.GET_MCCONF_TEMP)
    events = tick(link, vesc, MS)
    assert c.SetErpm(4614.0) in vesc.seen
    assert [s for s in vesc.seen if isinstance(s, c.SetServoPos)] == [c.SetServoPos(0.409)]
    assert telemetry_in(events).reply.erpm == 4614.0
    assert (t.Imu in kinds(events)) == (firmware >= (3, 52))
    assert (t.Uptime in kinds(events)) == (firmware >= FW_5_03)


def test_connect_asks_again_after_silence_and_goes_on_without_configuration(vesc):
    link = v.VescLink(F1TENTH)
    assert link.make_connect(0) == encode_frame(b"\0")
    assert link.make_connect(v.EXPIRY_NS) == b""
    assert link.make_connect(v.EXPIRY_NS + 1) == encode_frame(b"\0")
    link.on_bytes(v.EXPIRY_NS + 2, vesc.answer(encode_frame(b"\0")))
    requested = []
    for n in range(2, 40):
        requested.append(link.make_connect(n * 100 * MS))
        link.on_bytes(n * 100 * MS, b"")
    assert requested.count(encode_frame(b"\x11")) == v.CONNECT_TRIES
    assert requested.count(encode_frame(b"\x5b")) == v.CONNECT_TRIES
    assert link.ready
    assert link.appconf is None


def test_one_tick_is_one_write_of_one_usb_packet_and_braking_needs_no_identity(link, vesc):
    data = link.make_tick(DRIVE, 0)
    assert len(data) <= v.WRITE_LIMIT
    vesc.answer(data)
    assert vesc.seen == [
        c.SetErpm(4614.0), c.SetServoPos(0.409), c.GetValuesSelective(t.FAST_MASK),
        c.GetImuData(t.IMU_ACCEL_GYRO_MASK), c.GetValuesSetupSelective(t.UPTIME_MASK),
    ]  # fmt: skip
    vesc.seen.clear()
    vesc.answer(v.VescLink(F1TENTH).make_tick(brake(5.0), 0))
    assert vesc.seen == [c.SetCurrentBrake(5.0)]


@pytest.mark.parametrize(("drive", "motion"), [
    (brake(8.0), [c.SetCurrentBrake(8.0)]),
    (brake(8.0, 0.0), [c.SetCurrentBrake(8.0), c.SetServoPos(0.53)]),
    (v.Drive(ActuationMode.SHORT), [c.SetDuty(0.0)]),
    (v.Drive(ActuationMode.RELEASE), [c.SetCurrent(0.0)]), (SILENT, []),
    (v.Drive(steer=0.0), [c.SetServoPos(0.53)]),
    (v.Drive(ActuationMode.SPEED, 9.0, 99.0), [c.SetErpm(23250.0), c.SetServoPos(0.15)]),
], ids=lambda value: type(value).__name__)  # fmt: skip
def test_drive_orders(link, vesc, drive, motion):
    vesc.answer(link.make_tick(drive, 0))
    assert [s for s in vesc.seen if not type(s).__name__.startswith("Get")] == motion


@pytest.mark.parametrize("drive", [
    *(v.Drive(ActuationMode.SPEED, *each) for each in ((nan, 1.0), (0.0, nan), (0.0, inf))),
    brake(nan, 0.0), brake(1.0, inf),
])  # fmt: skip
def test_order_that_is_no_number_sends_nothing_and_leaves_polls_open(link, vesc, drive):
    with pytest.raises(ValueError, match=r"no command|cannot be sent"):
        link.make_tick(drive, 0)
    assert t.Values in kinds(tick(link, vesc, 0, brake(5.0)))


def test_reply_carries_send_and_first_byte_stamps(link, vesc):
    reply = vesc.answer(link.make_tick(DRIVE, 10 * MS))
    assert link.on_bytes(11 * MS, reply[:1]) == []
    events = link.on_bytes(13 * MS, reply[1:])
    telemetry, imu, _ = events
    assert (kinds(events), when(telemetry)) == ([t.Values, t.Imu, t.Uptime], (10 * MS, 11 * MS))
    assert telemetry_in(events).stamp_ns == 10 * MS + MS // 2
    assert when(imu) == (10 * MS, 13 * MS)


def test_polls_that_went_lost_are_repeated_five_times_in_100_ms(link):
    sent = [bool(link.make_tick(SILENT, t_ms * MS)) for t_ms in range(0, 100, 10)]
    assert sent == [True, False] * 5


def test_a_reply_after_several_repeats_may_answer_the_first_of_them(link, vesc):
    first = vesc.answer(link.make_tick(SILENT, 0))
    for t_ms in (20, 40, 60):
        link.make_tick(SILENT, t_ms * MS)
    assert when(telemetry_in(link.on_bytes(61 * MS, first))) == (0, 61 * MS)


def test_late_reply_keeps_its_true_interval(link, vesc):
    late = vesc.answer(link.make_tick(SILENT, 0))
    link.on_bytes(81 * MS, b"")
    second = vesc.answer(link.make_tick(SILENT, 82 * MS))
    assert when(telemetry_in(link.on_bytes(83 * MS, late))) == (0, 83 * MS)
    assert link.on_bytes(84 * MS, second) == []
    assert when(telemetry_in(tick(link, vesc, 90 * MS, SILENT))) == (90 * MS, 91 * MS)


@pytest.mark.parametrize(("cut", "whole"), [(56, t.Values), (51, t.Values), (50, None), (42, None)])
def test_replies_shorter_than_the_firmware_sends_are_refused(link, cut, whole):
    link.make_tick(SILENT, 0)
    payload = encode_reply(dataclasses.replace(VALUES, mask=t.FAST_MASK))
    events = link.on_bytes(MS, encode_frame((payload + bytes(9))[:cut]))
    assert kinds(events) == [whole] * (whole is not None)
    imu = encode_reply(t.Imu(t.IMU_ACCEL_GYRO_MASK))
    assert link.on_bytes(MS, encode_frame(imu[:-5])) == []


def test_old_firmware_accepts_its_own_table_alone():
    link, vesc = v.VescLink(F1TENTH), Vesc(FW_3_00)
    connect(link, vesc)
    link.make_tick(SILENT, 0)
    assert link.on_bytes(MS, encode_frame(encode_reply(VALUES, FW_7_01))) == []


def test_frames_that_answer_nothing_are_no_events(link):
    frames = [b"\x15hello", b"\x16\0\0\0\0", b"\x24abc", b"\xfa\1", b"\x00\x07", b"\x30"]
    assert link.on_bytes(MS, b"".join(map(encode_frame, frames))) == []


def test_restart_is_seen_by_uptime_tachometer_and_watchdog_fault(link, vesc):
    def reasons(n: int) -> list[str]:
        return [e.reason for e in tick(link, vesc, n) if isinstance(e, v.Rebooted)]

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


def test_uptime_is_requested_once_a_second_and_alive_never_sent(link, vesc):
    drives = itertools.cycle((DRIVE, brake(1.0), SILENT, v.Drive(ActuationMode.RELEASE)))
    for n in range(1000):
        vesc.uptime_ms += 5
        tick(link, vesc, n * 5 * MS, next(drives))
    counts = Counter(map(type, vesc.seen))
    assert (counts[c.GetValuesSetupSelective], counts[c.GetValuesSelective]) == (5, 1000)
    assert c.Alive not in counts


def test_requests_go_out_when_there_is_room(link, vesc):
    limits = make_session_limits(link.limits, erpm_max=9228.0)
    link.request(limits)
    link.request(c.GetMcConfTemp())
    data = link.make_tick(DRIVE, 0)
    assert len(data) <= v.WRITE_LIMIT
    link.on_bytes(0, vesc.answer(data))
    assert not any(isinstance(s, c.SetMcConfTemp) for s in vesc.seen)
    data = link.make_tick(SILENT, 5 * MS)
    assert len(data) <= v.WRITE_LIMIT
    events = link.on_bytes(6 * MS, vesc.answer(data))
    assert kinds(events) == [i.Ack, t.Values]
    sent = next(s for s in vesc.seen if isinstance(s, c.SetMcConfTemp))
    assert (sent.store, sent.ack, sent.erpm_min, sent.erpm_max) == (False, True, -9228, 9228)
    vesc.limits = dataclasses.replace(vesc.limits, erpm_min=-9228, erpm_max=9228)
    assert i.McConfTemp in kinds(tick(link, vesc, 10 * MS))
    assert limits_hold(limits, link.limits)
    assert not limits_hold(make_restored_limits(LIMITS), link.limits)


def test_session_limits_only_ever_tighten():
    assert make_session_limits(LIMITS, erpm_max=1e6) == make_restored_limits(LIMITS)
    in_force = dataclasses.replace(LIMITS, current_max_scale=0.2, duty_max=0.99)
    tight = make_session_limits(in_force, erpm_max=5000)
    assert (tight.erpm_min, tight.erpm_max) == (-5000, 5000)
    assert (tight.current_min_scale, tight.current_max_scale) == (1, 0.2)
    assert (tight.duty_max, tight.watt_max) == (0.95, 1500)
    for wrong in (0.0, -1.0, nan, inf):
        with pytest.raises(ValueError, match="positive and finite"):
            make_session_limits(LIMITS, erpm_max=wrong)


def test_long_configuration_passes_the_running_ceiling_only_when_requested(link, vesc):
    assert link.on_bytes(0, encode_frame(encode_reply(vesc.appconf)) + bytes(600)) == []
    link.request(c.GetAppConf())
    assert i.AppConf in kinds(tick(link, vesc, MS))


def test_reset_forgets_the_device_and_its_fault(link, vesc):
    vesc.values = dataclasses.replace(VALUES, fault=10)
    assert v.Rebooted in kinds(tick(link, vesc, 0))
    assert v.Rebooted not in kinds(tick(link, vesc, 2 * MS))
    link.reset()
    assert (link.version, link.limits, link.ready) == (None, None, False)
    connect(link, vesc, 10 * MS)
    assert v.Rebooted in kinds(tick(link, vesc, 500 * MS))


def test_a_request_that_drives_or_that_the_firmware_cannot_answer_is_refused_at_once():
    link, vesc = v.VescLink(F1TENTH), Vesc(Firmware(3, 40))
    connect(link, vesc)
    for command in (c.SetErpm(0.0), c.Alive(), c.SetServoPos(0.5), c.Reboot()):
        with pytest.raises(ValueError, match="not sent on request"):
            link.request(command)
    with pytest.raises(ValueError, match="needs firmware"):
        link.request(c.GetMcConfTemp())
    assert encode_command(c.GetMcConfTemp())
