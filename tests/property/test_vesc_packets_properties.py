"""Properties of VESC packets and the client: any numbers, any payload, any bytes."""

import dataclasses
import math

from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.steer_bus.messages import ActuationMode
from steerd.vesc_link import commands as c
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.ids import PROFILES, Firmware
from steerd.vesc_link.packets import decode_command, decode_reply, encode_command, encode_reply
from steerd.vesc_link.scaling import F1TENTH
from steerd.vesc_link.vesc import WRITE_LIMIT, Drive, VescLink

CHECKED = settings(derandomize=True, deadline=None, database=None, max_examples=200)
FIRMWARE = st.sampled_from((Firmware(2, 18), *PROFILES))
SINGLE = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(st.binary(max_size=200), FIRMWARE)
@CHECKED
def test_any_payload_decodes_or_is_refused_without_raising(data, fw):
    for number in (*range(10), 11, 12, 17, 20, 21, 29, 30, 47, 48, 50, 51, 65, 91):
        payload = bytes((number,)) + data
        command = decode_command(payload, fw)
        reply = decode_reply(payload, fw)
        for value in (command, reply):
            numbers = dataclasses.asdict(value).values() if value is not None else ()
            assert all(math.isfinite(n) for n in numbers if isinstance(n, float))


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


DRIVES = st.builds(
    Drive, st.sampled_from(ActuationMode), st.none() | st.floats(), st.floats(), st.floats()
)


@given(st.lists(st.tuples(DRIVES, st.binary(max_size=80)), max_size=15))
@CHECKED
def test_client_outlives_any_bytes_and_writes_one_packet_of_known_commands(ticks):
    link = VescLink(F1TENTH, imu_mask=t.IMU_ACCEL_GYRO_MASK)
    link.make_connect(0)
    link.on_bytes(1, encode_frame(b"\x00\x07\x01"))
    for n, (drive, data) in enumerate(ticks):
        try:
            written = link.make_tick(drive, n * 5_000_000)
        except ValueError:
            written = link.make_tick(Drive(ActuationMode.BRAKE, current=5.0), n * 5_000_000)
        assert len(written) <= WRITE_LIMIT
        link.on_bytes(n * 5_000_000 + 1, data + encode_frame(data[:50] or b"\x04"))
