"""What a VESC measures: telemetry, its clock, and its IMU.

A field that the firmware did not send is None, never zero. Fields are read in order until the
payload ends, so one rule serves every firmware from 2.18 to 7.01 and masks with bits that an old
firmware does not know. Source: `docs/reference/vesc-serial.md#v2.1`, `#v2.2`, `#v2.3`.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from operator import truediv
from typing import Annotated

from steerd.steer_bus.quick_values import quick_value
from steerd.vesc_link.ids import FW_3_00, FW_5_03, FW_6_05, CommandId, Firmware
from steerd.vesc_link.wire import Field, pack_device, reader, unpack_fields, wire_fields

STANDARD_GRAVITY = 9.80665
"""[m/s^2], the firmware's g."""
FAST_MASK = 0x0038E1FF
"""GET_VALUES_SELECTIVE bits 0-8, 13-15 and 19-21: all that a controller or a motor fit needs."""
UPTIME_MASK = 0x00200000
"""GET_VALUES_SETUP_SELECTIVE bit 21."""
IMU_ACCEL_GYRO_MASK = 0x01F8


@quick_value
class Values:
    """GET_VALUES or GET_VALUES_SELECTIVE reply [A, V, °C, Ah, Wh].

    Currents and ``v_d``, ``v_q`` are means since the last read by anyone. The tachometer counts six
    steps per electrical revolution. ``mask`` is the echoed mask, None for a full reply. Behind the
    types: `wire.Field`.
    """

    temp_fet_c: Annotated[float | None, "h", 1e1] = None
    temp_motor_c: Annotated[float | None, "h", 1e1] = None
    motor_current: Annotated[float | None, "i", 1e2] = None
    input_current: Annotated[float | None, "i", 1e2] = None
    d_current: Annotated[float | None, "i", 1e2] = None
    q_current: Annotated[float | None, "i", 1e2] = None
    duty: Annotated[float | None, "h", 1e3] = None
    erpm: Annotated[float | None, "i", 1e0] = None
    input_voltage: Annotated[float | None, "h", 1e1] = None
    ah: Annotated[float | None, "i", 1e4] = None
    ah_charged: Annotated[float | None, "i", 1e4] = None
    wh: Annotated[float | None, "i", 1e4] = None
    wh_charged: Annotated[float | None, "i", 1e4] = None
    tachometer: Annotated[int | None, "i"] = None
    tachometer_abs: Annotated[int | None, "i"] = None
    fault: Annotated[int | None, "B"] = None
    pid_pos_deg: Annotated[float | None, "i", 1e6, Firmware(3, 34)] = None
    controller_id: Annotated[int | None, "B", None, Firmware(3, 40)] = None
    temp_mos1_c: Annotated[float | None, "h", 1e1, Firmware(3, 48)] = None
    temp_mos2_c: Annotated[float | None, "h", 1e1, Firmware(3, 48)] = None
    temp_mos3_c: Annotated[float | None, "h", 1e1, Firmware(3, 48)] = None
    v_d: Annotated[float | None, "i", 1e3, Firmware(3, 60)] = None
    v_q: Annotated[float | None, "i", 1e3, Firmware(3, 60)] = None
    status: Annotated[int | None, "B", None, Firmware(5, 3)] = None
    temp_mos4_c: Annotated[float | None, "h", 1e1] = None
    temp_mos5_c: Annotated[float | None, "h", 1e1] = None
    temp_mos6_c: Annotated[float | None, "h", 1e1] = None
    temp_pcb_c: Annotated[float | None, "h", 1e1] = None
    mask: int | None = None


_VALUES = wire_fields(Values)
_VALUES_BITS = (
    *((field,) for field in _VALUES[:18]),
    _VALUES[18:21],  # the temperatures of three switches share a bit
    *((field,) for field in _VALUES[21:24]),
)
_OLD_VALUES = (*_VALUES[18:21], *_VALUES[24:28], *_VALUES[2:4], *_VALUES[6:16])
_OLD_VALUES_SIZE = 56
"""Reply length that distinguishes the table of firmware 3.00 and older from all later ones."""


@dataclass(frozen=True, slots=True)
class Uptime:
    """GET_VALUES_SETUP_SELECTIVE reply to `UPTIME_MASK`: the VESC's own clock [ms since boot]."""

    uptime_ms: int
    mask: int = UPTIME_MASK


_Single = Annotated[float | None, "f"]


@quick_value
class Imu:
    """GET_IMU_DATA reply in SI units: rad, m/s², rad/s; the magnetometer as the board scales it.

    Take the attitude from the quaternion: the firmware's roll and yaw have the opposite sign of the
    standard ones. ``controller_id`` is sent since firmware 6.05.
    """

    mask: int
    roll: _Single = None
    pitch: _Single = None
    yaw: _Single = None
    accel_x: _Single = None
    accel_y: _Single = None
    accel_z: _Single = None
    gyro_x: _Single = None
    gyro_y: _Single = None
    gyro_z: _Single = None
    mag_x: _Single = None
    mag_y: _Single = None
    mag_z: _Single = None
    q_w: _Single = None
    q_x: _Single = None
    q_y: _Single = None
    q_z: _Single = None
    controller_id: Annotated[int | None, "B", None, FW_6_05] = None


def has_chip(accel_x: float, accel_y: float, accel_z: float) -> bool:
    """False if the board has no IMU: it answers with zeros all the same.

    A real accelerometer at rest reads 1 g; below 0.1 g [m/s²] there is none
    (`docs/reference/vesc-serial.md#v2.3.3`). False for NaN too.
    """
    return math.hypot(accel_x, accel_y, accel_z) >= 0.1 * STANDARD_GRAVITY


_IMU_UNIT = {
    **dict.fromkeys(("accel_x", "accel_y", "accel_z"), STANDARD_GRAVITY),
    **dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), math.pi / 180),
}
*_IMU_NUMBERS, _IMU_ID = wire_fields(Imu)
_IMU_BITS = tuple((field,) for field in _IMU_NUMBERS)


@lru_cache(maxsize=64)
def _selected(
    bits: tuple[tuple[Field, ...], ...], mask: int | None, firmware: Firmware | None
) -> tuple[Field, ...]:
    """Fields in bit order; a mask of None selects all, a firmware of None knows all."""
    return tuple(
        field
        for bit, fields in enumerate(bits)
        for field in fields
        if (mask is None or mask >> bit & 1) and (firmware is None or firmware >= field.since)
    )


def decode_values(payload: bytes) -> Values:
    """Decode a full telemetry reply; its length identifies the firmware's table."""
    old = len(payload) == _OLD_VALUES_SIZE
    fields = _OLD_VALUES if old else _selected(_VALUES_BITS, None, None)
    return Values(**unpack_fields(fields, payload, 1))


def decode_values_selective(payload: bytes) -> Values | None:
    """Decode a selective telemetry reply; None if the mask itself is cut."""
    if len(payload) < 5:
        return None
    mask = int.from_bytes(payload[1:5], "big")
    return Values(**unpack_fields(_selected(_VALUES_BITS, mask, None), payload, 5), mask=mask)


def decode_uptime(payload: bytes) -> Uptime | None:
    """Decode the VESC's clock; None if it is cut or the reply to another mask."""
    mask = int.from_bytes(payload[1:5], "big")
    known = mask == UPTIME_MASK and len(payload) >= 9
    return Uptime(int.from_bytes(payload[5:9], "big")) if known else None


@lru_cache(maxsize=64)
def _imu_fields(mask: int) -> tuple[Field, ...]:
    """Fields of an IMU reply, the trailer of newer firmware included."""
    return (*_selected(_IMU_BITS, mask, None), _IMU_ID)


def decode_imu(payload: bytes) -> Imu | None:
    """Decode an IMU reply into SI units; None if the mask is cut or a number not finite."""
    if len(payload) < 3:
        return None
    mask = int.from_bytes(payload[1:3], "big")
    values = unpack_fields(_imu_fields(mask), payload, 3)
    if not math.isfinite(sum(values.values())):  # no sum of single-precision numbers overflows
        return None
    for name, unit in _IMU_UNIT.items():
        if name in values:
            values[name] *= unit
    return Imu(mask, **values)


@lru_cache(maxsize=64)
def values_size(mask: int | None, firmware: Firmware) -> int:
    """Payload length of the telemetry reply that this firmware sends [bytes]."""
    if mask is None and firmware <= FW_3_00:
        return _OLD_VALUES_SIZE
    head = 1 if mask is None else 5
    return head + sum(field.size for field in _selected(_VALUES_BITS, mask, firmware))


@lru_cache(maxsize=64)
def _imu_units(fields: tuple[Field, ...]) -> tuple[float, ...]:
    return tuple(_IMU_UNIT.get(field.name, 1.0) for field in fields)


def _device_bytes(reply: Values | Imu, fields: tuple[Field, ...]) -> bytes:
    numbers = [value or 0 for value in reader(fields)(reply)]
    if type(reply) is Imu:
        numbers = list(map(truediv, numbers, _imu_units(fields)))
    return pack_device(fields, numbers)


def encode_values(reply: Values, firmware: Firmware) -> bytes:
    """Telemetry reply as this firmware sends it; what is None goes out as zero."""
    if reply.mask is None:
        old = firmware <= FW_3_00
        fields = _OLD_VALUES if old else _selected(_VALUES_BITS, None, firmware)
        return bytes((CommandId.GET_VALUES,)) + _device_bytes(reply, fields)
    head = bytes((CommandId.GET_VALUES_SELECTIVE,)) + reply.mask.to_bytes(4, "big")
    return head + _device_bytes(reply, _selected(_VALUES_BITS, reply.mask, firmware))


def encode_uptime(reply: Uptime, firmware: Firmware) -> bytes:
    """The VESC's clock; firmware before 5.03 echoes the mask alone."""
    head = bytes((CommandId.GET_VALUES_SETUP_SELECTIVE,)) + reply.mask.to_bytes(4, "big")
    return head + (reply.uptime_ms.to_bytes(4, "big") if firmware >= FW_5_03 else b"")


def encode_imu(reply: Imu, firmware: Firmware) -> bytes:
    """IMU reply as this firmware sends it, converted back to g and deg/s."""
    head = bytes((CommandId.GET_IMU_DATA,)) + reply.mask.to_bytes(2, "big")
    body = _device_bytes(reply, _selected(_IMU_BITS, reply.mask, None))
    trailer = bytes((reply.controller_id or 0,)) if firmware >= FW_6_05 else b""
    return head + body + trailer
