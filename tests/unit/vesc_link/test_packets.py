"""Packets of every firmware, and the scaling between them and SI units."""

import dataclasses
import math
import struct
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.sim_hw.vesc.vesc_device import make_fw_version
from steerd.sim_hw.vesc.vesc_motor import VescConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link import identity as i
from steerd.vesc_link import packets
from steerd.vesc_link import scaling as s
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.ids import FW_3_00, FW_7_01, PROFILES, Firmware, fault_name, knows
from steerd.vesc_link.packets import decode_command, decode_reply, encode_command, encode_reply
from steerd.vesc_link.wire import Field, host_number, pack_device

LIMITS_SET = c.SetMcConfTemp(0.5, 0.5, -9228, 9228, 0.25, 0.75, -500, 500, -20, 40, ack=False)
EXAMPLES: tuple[c.Command, ...] = (
    c.GetFwVersion(), c.GetValues(), c.SetDuty(-0.5), c.SetCurrent(1.25), c.SetCurrentBrake(8.0),
    c.SetErpm(1234.0), c.SetServoPos(0.25), c.GetAppConf(),
    c.Reboot(), c.Alive(), c.GetValuesSelective(0x180), LIMITS_SET,
    c.GetValuesSetupSelective(t.UPTIME_MASK), c.GetImuData(0x1F8), c.GetMcConfTemp(),
)  # fmt: skip
OLD_AND_NEW = (Firmware(2, 18), FW_3_00, Firmware(3, 27), Firmware(3, 55), *PROFILES)
ALL_VALUES = t.Values(
    temp_fet_c=31.5, temp_motor_c=-12.5, motor_current=-3.25, input_current=1.25, d_current=0.25,
    q_current=-3.5, duty=-0.125, erpm=-2307.0, input_voltage=11.5, ah=0.25, ah_charged=0.125,
    wh=1.5, wh_charged=0.0625, tachometer=-123456, tachometer_abs=223344, fault=2,
    pid_pos_deg=11.25, controller_id=107, temp_mos1_c=31.0, temp_mos2_c=31.5, temp_mos3_c=30.5,
    v_d=-0.25, v_q=-1.75, status=3, temp_mos4_c=28.5, temp_mos5_c=28.0, temp_mos6_c=27.5,
    temp_pcb_c=29.5,
)  # fmt: skip
FULL_SIZE = {
    (2, 18): 56, (3, 0): 56, (3, 27): 54, (3, 34): 58, (3, 40): 59, (3, 55): 65, (3, 60): 73,
    (5, 2): 73, (5, 3): 74, (6, 0): 74, (6, 5): 74, (7, 1): 74,
}  # fmt: skip


def present(values: t.Values) -> dict[str, object]:
    return {k: v for k, v in dataclasses.asdict(values).items() if v is not None}


@pytest.mark.parametrize("firmware", OLD_AND_NEW, ids=str)
@pytest.mark.parametrize("command", EXAMPLES, ids=lambda command: type(command).__name__)
def test_command_round_trip_on_every_firmware(command, firmware):
    if not knows(firmware, packets.command_number(command)):
        with pytest.raises(ValueError, match="needs firmware"):
            encode_command(command, firmware)
        assert decode_command(encode_command(command), firmware) is None
        return
    assert decode_command(encode_command(command, firmware), firmware) == command


@pytest.mark.parametrize("command", EXAMPLES, ids=lambda command: type(command).__name__)
def test_command_cut_at_any_byte_is_no_command(command):
    payload = encode_command(command)
    for length in range(len(payload)):
        assert decode_command(payload[:length]) is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e12, -1e12, 1e305])
@pytest.mark.parametrize("name", ["Duty", "Current", "CurrentBrake", "Erpm", "ServoPos"])
def test_setpoint_that_is_no_number_is_refused(name, value):
    with pytest.raises(ValueError, match=r"cannot be sent|does not fit"):
        encode_command(getattr(c, f"Set{name}")(value))


def test_limits_that_are_no_number_are_refused_both_ways():
    limits = dataclasses.replace(LIMITS_SET, watt_max=math.nan)
    with pytest.raises(ValueError, match="finite"):
        encode_command(limits)
    payload = bytearray(encode_command(LIMITS_SET))
    payload[5:9] = struct.pack(">f", math.nan)
    assert decode_command(bytes(payload)) is None


def test_what_feeds_the_motor_timeout_and_what_is_answered():
    assert {type(example) for example in EXAMPLES} == set(get_args(c.Command))
    fed = {packets.command_number(e) for e in EXAMPLES if isinstance(e, packets.FEEDS_TIMEOUT)}
    assert fed == {5, 6, 7, 8, 30}
    answered = {packets.command_number(e) for e in EXAMPLES if packets.expects_reply(e)}
    assert answered == {0, 4, 17, 50, 51, 65, 91}
    assert packets.expects_reply(dataclasses.replace(LIMITS_SET, ack=True))
    fast = encode_reply(dataclasses.replace(ALL_VALUES, mask=t.FAST_MASK))
    assert len(encode_frame(fast)) == 56, "one USB packet"
    named = {10: "BOOTING_FROM_WATCHDOG_RESET", 33: "ABS_OVERSPEED", 34: "FAULT_34"}
    assert {n: fault_name(n) for n in named} == named
    assert LIMITS.erpm_gain == pytest.approx(60 * 2 * 11.75 / (math.pi * 0.125))


def test_old_firmware_shifts_ids_from_the_handbrake_on():
    assert encode_command(c.SetServoPos(0.5), FW_3_00)[0] == 11
    assert encode_command(c.Alive(), FW_3_00)[0] == 29
    assert encode_command(c.Alive(), Firmware(3, 7))[0] == 30
    assert decode_command(b"\x1d", FW_3_00) == c.Alive()
    assert decode_command(b"\x1d", FW_7_01) == c.Reboot()
    assert decode_command(encode_command(c.SetErpm(1.0), FW_3_00), FW_3_00) == c.SetErpm(1.0)


def test_device_saturates_float_auto_has_no_denormals_and_the_longest_uptime_comes_back():
    assert pack_device((Field("", "h", 1e1),), (1e9,)) == b"\x7f\xff"
    assert pack_device((Field("", "B", None),), (-4,)) == b"\0"
    assert host_number("f", None, 1e-39) == 0
    assert math.copysign(1, host_number("f", None, -0.0)) == 1
    with pytest.raises(ValueError, match="finite"):
        pack_device((Field("", "f", None),), (3.5e38,))
    assert decode_reply(encode_reply(t.Uptime(0xFFFFFFFF))) == t.Uptime(0xFFFFFFFF)


@pytest.mark.parametrize(("version", "size"), FULL_SIZE.items())
def test_full_telemetry_of_every_firmware(version, size):
    firmware = Firmware(*version)
    payload = encode_reply(ALL_VALUES, firmware)
    assert len(payload) == size == t.values_size(None, firmware)
    values = decode_reply(payload, firmware)
    known = present(values)
    assert {k: v for k, v in present(ALL_VALUES).items() if k in known} == known
    assert (values.status is None) == (firmware < (5, 3))
    assert (values.q_current is None) == (firmware <= FW_3_00)
    assert (values.temp_pcb_c is None) == (firmware > FW_3_00)


def test_telemetry_cut_at_any_byte_has_no_invented_field():
    payload = encode_reply(ALL_VALUES)
    for length in range(1, len(payload) + 20):
        if length == 56:
            continue  # that length is the old firmware's table
        values = decode_reply((payload + bytes(20))[:length])
        assert isinstance(values, t.Values)
        known = present(values)
        assert {k: v for k, v in present(ALL_VALUES).items() if k in known} == known


IMU = t.Imu(
    0xFFFF, 0.1, -0.2, 0.3, 0.5, -1.0, 9.75, 0.25, -0.5, 2.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0,
    0.0, controller_id=9,
)  # fmt: skip


def test_board_without_imu_answers_zeros_and_is_recognised():
    nothing = decode_reply(encode_reply(t.Imu(t.IMU_ACCEL_GYRO_MASK)))
    assert not t.has_chip(nothing.accel_x, nothing.accel_y, nothing.accel_z)
    assert t.has_chip(IMU.accel_x, IMU.accel_y, IMU.accel_z)


LIMITS = i.McConfTemp(1, 1, -23250, 23250, 0.25, 0.75, -1500, 1500, -20, 40, 4, 11.75, 0.125)
APPCONF = i.AppConf(0xDEADBEEF, 12, 1000, 8.5, bytes(range(200)))


@pytest.mark.parametrize(("firmware", "size"), [
    ((2, 18), 3), ((3, 40), 22), ((3, 60), 23), ((5, 2), 26), ((5, 3), 29), ((6, 0), 31),
    ((6, 5), 35), ((7, 1), 35),
])  # fmt: skip
def test_version_reply_of_every_firmware(firmware, size):
    reply = make_fw_version(VescConfig(firmware=Firmware(*firmware)), bytes(12))
    payload = encode_reply(reply, Firmware(*firmware))
    assert len(payload) == size
    got = decode_reply(payload)
    assert got == (reply if size > 3 else i.FwVersion(*firmware))
    assert got.firmware == firmware
    with pytest.raises(ValueError, match="12 bytes"):
        encode_reply(dataclasses.replace(reply, uuid=b"short"), FW_7_01)


@pytest.mark.parametrize("reply", [LIMITS, IMU, APPCONF], ids=lambda r: str(type(r)))
def test_reply_with_a_number_that_is_none_is_refused(reply):
    payload = encode_reply(reply)
    at = {t.Imu: 3, i.AppConf: 10}.get(type(reply), 1)
    assert decode_reply(payload[:at] + struct.pack(">f", math.nan) + payload[at + 4 :]) is None


# Scaling between packets and SI units.
def test_f1tenth_numbers_of_the_spec_page():
    assert s.speed_to_erpm(s.F1TENTH, 1.0) == 4614.0
    assert s.erpm_to_speed(s.F1TENTH, 23250.0) == pytest.approx(5.04, abs=0.002)
    assert s.steer_to_servo_pos(s.F1TENTH, 0.0) == 0.5304
    right, left = s.steer_limits(s.F1TENTH)
    assert math.degrees(left) == pytest.approx(17.96, abs=0.01)
    assert math.degrees(right) == pytest.approx(-15.09, abs=0.01)


@pytest.mark.parametrize(("steer", "speed"), [(-0.26, -5.0), (-0.1, -0.3), (0.0, 0.0), (0.31, 5.0)])
def test_angles_and_speeds_with_an_offset_come_back(steer, speed):
    scaling = s.Scaling(erpm_offset=35.0)
    position = s.steer_to_servo_pos(scaling, steer)
    assert s.servo_pos_to_steer(scaling, position) == pytest.approx(steer)
    assert s.erpm_to_speed(scaling, s.speed_to_erpm(scaling, speed)) == pytest.approx(speed)


@pytest.mark.parametrize(("convert", "least", "most"), [
    (s.steer_to_servo_pos, 0.85, 0.15), (s.speed_to_erpm, -23250.0, 23250.0),
])  # fmt: skip
def test_numbers_are_clamped_both_ways_and_what_is_none_never(convert, least, most):
    assert (convert(s.F1TENTH, -1e6), convert(s.F1TENTH, 1e6)) == (least, most)
    for value in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match="no command"):
            convert(s.F1TENTH, value)


@pytest.mark.parametrize("wrong", [
    {"erpm_gain": 0.0}, {"servo_gain": 0.0}, {"erpm_gain": math.nan}, {"servo_min": 0.9},
    {"servo_min": -0.1}, {"servo_max": 1.1}, {"erpm_max": 0.0}, {"erpm_max": math.inf},
])  # fmt: skip
def test_unusable_calibration_is_refused(wrong):
    with pytest.raises(ValueError, match=r"must|finite"):
        s.Scaling(**wrong)


# What filter and recording believe was sent is what a VESC makes of the bytes.
@given(st.floats(-0.4, 0.4), st.floats(-6.0, 6.0))
@settings(derandomize=True, deadline=None)
def test_as_sent_is_what_the_device_decodes_and_sent_again_the_same(steer, speed):
    servo = decode_command(encode_command(c.SetServoPos(s.steer_to_servo_pos(s.F1TENTH, steer))))
    erpm = decode_command(encode_command(c.SetErpm(s.speed_to_erpm(s.F1TENTH, speed))))
    once = s.as_sent(s.F1TENTH, steer, speed)
    assert abs(once[0] - s.servo_pos_to_steer(s.F1TENTH, servo.servo_pos)) < 1e-6
    assert abs(once[1] - s.erpm_to_speed(s.F1TENTH, erpm.erpm)) < 1e-9
    assert s.as_sent(s.F1TENTH, *once) == pytest.approx(once, abs=1e-12)
