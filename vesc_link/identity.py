"""What a VESC is and how it is set: version and UUID, timeout, limits, and limits of a session.

A session's limits live in the VESC's RAM, whatever the host does: SET_MCCONF_TEMP without
``store``, read back with GET_MCCONF_TEMP, restored at the end and gone after a power cycle
(`docs/reference/vesc-serial.md#v3.9`). Source of the layouts: `docs/reference/vesc-serial.md#v2`,
`docs/reference/vesc-serial.md#v2.4`; of GET_APPCONF `docs/reference/vesc-serial.md#v2.6`.
"""

import math
from dataclasses import dataclass
from typing import Any

from steerd.vesc_link.commands import SetMcConfTemp
from steerd.vesc_link.ids import CommandId, Firmware
from steerd.vesc_link.wire import Field, all_finite, pack_device, reader, unpack_fields


@dataclass(frozen=True, slots=True)
class FwVersion:
    """FW_VERSION reply; what the firmware did not send is None.

    The UUID is the only identity: USB serial numbers are the same on every VESC.
    """

    major: int
    minor: int
    hw_name: str | None = None
    uuid: bytes | None = None
    paired: int | None = None
    test_build: int | None = None
    hw_type: int | None = None
    custom_config_count: int | None = None
    phase_filters: int | None = None
    qml_hw: int | None = None
    qml_app: int | None = None
    nrf_flags: int | None = None
    fw_name: str | None = None
    hw_config_crc: int | None = None
    extra_bytes: int = 0

    @property
    def firmware(self) -> Firmware:
        """Version to compare layouts with."""
        return Firmware(self.major, self.minor)


_VERSION_FIELDS = (
    Field("hw_name", "text", None, Firmware(3, 7)),
    Field("uuid", "12s", None, Firmware(3, 7)),
    Field("paired", "B", None, Firmware(3, 48)),
    Field("test_build", "B", None, Firmware(5, 0)),
    Field("hw_type", "B", None, Firmware(5, 2)),
    Field("custom_config_count", "B", None, Firmware(5, 2)),
    Field("phase_filters", "B", None, Firmware(5, 3)),
    Field("qml_hw", "B", None, Firmware(5, 3)),
    Field("qml_app", "B", None, Firmware(5, 3)),
    Field("nrf_flags", "B", None, Firmware(6, 0)),
    Field("fw_name", "text", None, Firmware(6, 0)),
    Field("hw_config_crc", "I", None, Firmware(6, 5)),
)


def decode_fw_version(payload: bytes) -> FwVersion | None:
    """Decode while bytes remain; None if not even the version is there."""
    if len(payload) < 3:
        return None
    values: dict[str, Any] = {}
    at = 3
    for field in _VERSION_FIELDS:
        size = payload.find(b"\0", at) + 1 - at if field.code == "text" else field.size
        if size < 1 or at + size > len(payload):
            break
        values[field.name] = _version_value(field.code, payload[at : at + size])
        at += size
    return FwVersion(payload[1], payload[2], **values, extra_bytes=len(payload) - at)


def _version_value(code: str, raw: bytes) -> str | bytes | int:
    if code == "text":
        return raw[:-1].decode("latin-1")
    return raw if code == "12s" else int.from_bytes(raw, "big")


def encode_fw_version(reply: FwVersion, firmware: Firmware) -> bytes:
    """FW_VERSION reply as this firmware sends it; absent text is empty, absent numbers zero.

    Raises:
        ValueError: the UUID is not 12 bytes long.
    """
    parts = [bytes((CommandId.FW_VERSION, reply.major, reply.minor))]
    for field in _VERSION_FIELDS:
        if firmware < field.since:
            break
        value = getattr(reply, field.name)
        if field.code == "text":
            parts.append((value or "").encode("latin-1") + b"\0")
        elif field.code == "12s":
            parts.append(_checked_uuid(value))
        else:
            parts.append((value or 0).to_bytes(field.size, "big"))
    return b"".join(parts)


def _checked_uuid(uuid: bytes | None) -> bytes:
    if uuid is None or len(uuid) != 12:
        raise ValueError("a VESC UUID has 12 bytes")
    return uuid


@dataclass(frozen=True, slots=True)
class AppConf:
    """GET_APPCONF reply: the head, the same in every firmware from 3.55 to 7.01, and the rest raw.

    ``timeout_ms`` 0 switches the VESC's own command timeout off; ``timeout_brake_current`` [A] is
    what it applies afterwards, 0 being coasting.
    """

    signature: int
    controller_id: int
    timeout_ms: int
    timeout_brake_current: float
    tail: bytes = b""


_APPCONF_FIELDS = (
    Field("signature", "I"),
    Field("controller_id", "B"),
    Field("timeout_ms", "I"),
    Field("timeout_brake_current", "f"),
)
_APPCONF_HEAD = 1 + sum(field.size for field in _APPCONF_FIELDS)


def decode_appconf(payload: bytes) -> AppConf | None:
    """Decode the head of an app configuration; None if it is cut or its brake current no number."""
    if len(payload) < _APPCONF_HEAD:
        return None
    values, _ = unpack_fields(_APPCONF_FIELDS, payload, 1)
    if not math.isfinite(values["timeout_brake_current"]):
        return None
    return AppConf(**values, tail=payload[_APPCONF_HEAD:])


def encode_appconf(reply: AppConf) -> bytes:
    """GET_APPCONF reply."""
    head = pack_device(_APPCONF_FIELDS, reader(_APPCONF_FIELDS)(reply))
    return bytes((CommandId.GET_APPCONF,)) + head + reply.tail


@dataclass(frozen=True, slots=True)
class McConfTemp:
    """GET_MCCONF_TEMP reply: limits in force [ERPM, duty, W, A] and the drive train."""

    current_min_scale: float
    current_max_scale: float
    erpm_min: float
    erpm_max: float
    duty_min: float
    duty_max: float
    watt_min: float
    watt_max: float
    input_current_min: float
    input_current_max: float
    motor_poles: int
    gear_ratio: float
    wheel_diameter: float

    @property
    def erpm_gain(self) -> float:
        """ERPM per m/s that these settings imply: ``60 * pole pairs * gear / (pi * D)``."""
        return 30 * self.motor_poles * self.gear_ratio / (math.pi * self.wheel_diameter)


LIMIT_FIELDS = tuple(
    Field(name, "f")
    for name in (
        "current_min_scale", "current_max_scale", "erpm_min", "erpm_max", "duty_min", "duty_max",
        "watt_min", "watt_max", "input_current_min", "input_current_max",
    )
)  # fmt: skip
"""The ten limits, in the order of GET_MCCONF_TEMP and SET_MCCONF_TEMP."""


_DRIVE_TRAIN = (Field("motor_poles", "B"), Field("gear_ratio", "f"), Field("wheel_diameter", "f"))
_MCCONF_FIELDS = (*LIMIT_FIELDS, *_DRIVE_TRAIN)


def decode_mcconf_temp(payload: bytes) -> McConfTemp | None:
    """Decode the limits in force; None if they are cut or one is no number."""
    values, _ = unpack_fields(_MCCONF_FIELDS, payload, 1)
    whole = len(values) == len(_MCCONF_FIELDS) and all_finite(values)
    return McConfTemp(**values) if whole else None


def encode_mcconf_temp(reply: McConfTemp) -> bytes:
    """GET_MCCONF_TEMP reply."""
    body = pack_device(_MCCONF_FIELDS, reader(_MCCONF_FIELDS)(reply))
    return bytes((CommandId.GET_MCCONF_TEMP,)) + body


@dataclass(frozen=True, slots=True)
class Print:
    """Text that the VESC prints, in answer to a terminal command or by itself."""

    text: str


@dataclass(frozen=True, slots=True)
class Ack:
    """A bare id sent back: the command was carried out."""

    command: CommandId


_F32_EPSILON = 1e-6


def make_session_limits(
    in_force: McConfTemp, erpm_max: float, current_scale: float = 1.0, duty_max: float = 0.95
) -> SetMcConfTemp:
    """Limits for a session: tighter than those in force or equal, never wider.

    Args:
        in_force: limits read before.
        erpm_max: largest ERPM in either direction.
        current_scale: share of the configured drive current, 0 to 1; braking keeps its share.
        duty_max: largest duty cycle.

    Raises:
        ValueError: a limit is not positive and finite, so the car could not move.
    """
    if not all(math.isfinite(x) and x > 0 for x in (erpm_max, current_scale, duty_max)):
        raise ValueError("session limits must be positive and finite")
    return SetMcConfTemp(
        current_min_scale=in_force.current_min_scale,
        current_max_scale=min(in_force.current_max_scale, current_scale),
        erpm_min=max(in_force.erpm_min, -erpm_max),
        erpm_max=min(in_force.erpm_max, erpm_max),
        duty_min=in_force.duty_min,
        duty_max=min(in_force.duty_max, duty_max),
        watt_min=in_force.watt_min,
        watt_max=in_force.watt_max,
        input_current_min=in_force.input_current_min,
        input_current_max=in_force.input_current_max,
    )


def make_restored_limits(before: McConfTemp) -> SetMcConfTemp:
    """The limits that were in force before the session."""
    return SetMcConfTemp(**{field.name: getattr(before, field.name) for field in LIMIT_FIELDS})


def limits_hold(requested: SetMcConfTemp, read_back: McConfTemp) -> bool:
    """Whether the limits read back are the ones set, within single precision."""
    return all(
        math.isclose(
            getattr(requested, field.name), getattr(read_back, field.name), rel_tol=_F32_EPSILON
        )
        for field in LIMIT_FIELDS
    )
