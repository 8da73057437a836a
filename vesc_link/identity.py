"""What a VESC is and how it is set: version and UUID, timeout, limits, and limits of a session.

A session's limits live in the VESC's RAM, whatever the host does: SET_MCCONF_TEMP without
``store``, read back with GET_MCCONF_TEMP, restored at the end and gone after a power cycle
(`docs/reference/vesc-serial.md#v3.9`). Source of the layouts: `docs/reference/vesc-serial.md#v2`,
`docs/reference/vesc-serial.md#v2.4`; of GET_APPCONF `docs/reference/vesc-serial.md#v2.6`.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from steerd.vesc_link.commands import Limits, SetMcConfTemp, Single
from steerd.vesc_link.ids import CommandId, Firmware
from steerd.vesc_link.wire import all_finite, pack_device, reader, unpack_fields, wire_fields


@dataclass(frozen=True, slots=True)
class FwVersion:
    """FW_VERSION reply: what identifies a VESC, and the rest raw; None where not sent.

    The UUID is the only identity: USB serial numbers are the same on every VESC.
    """

    major: int
    minor: int
    hw_name: str | None = None  # since firmware 3.07, as the UUID
    uuid: bytes | None = None
    tail: bytes = b""  # hardware type, test build and so on: more with every firmware since 3.48

    @property
    def firmware(self) -> Firmware:
        """Version to compare layouts with."""
        return Firmware(self.major, self.minor)


_UUID_BYTES = 12
_NAMED_SINCE, _TAIL_SINCE = Firmware(3, 7), Firmware(3, 48)


def decode_fw_version(payload: bytes) -> FwVersion | None:
    """Decode while bytes remain; None if not even the version is there."""
    if len(payload) < 3:
        return None
    name, mark, rest = payload[3:].partition(b"\0")
    hw_name = name.decode("latin-1") if mark else None
    if len(rest) < _UUID_BYTES:
        return FwVersion(payload[1], payload[2], hw_name)
    uuid, tail = rest[:_UUID_BYTES], rest[_UUID_BYTES:]
    return FwVersion(payload[1], payload[2], hw_name, uuid, tail)


def encode_fw_version(reply: FwVersion, firmware: Firmware) -> bytes:
    """FW_VERSION reply as this firmware sends it; an absent name is empty.

    Raises:
        ValueError: the UUID is not 12 bytes long.
    """
    head = bytes((CommandId.FW_VERSION, reply.major, reply.minor))
    if firmware < _NAMED_SINCE:
        return head
    if reply.uuid is None or len(reply.uuid) != _UUID_BYTES:
        raise ValueError("a VESC UUID has 12 bytes")
    named = head + (reply.hw_name or "").encode("latin-1") + b"\0" + reply.uuid
    return named + (reply.tail if firmware >= _TAIL_SINCE else b"")


@dataclass(frozen=True, slots=True)
class AppConf:
    """GET_APPCONF reply: the head, the same in every firmware from 3.55 to 7.01, and the rest raw.

    ``timeout_ms`` 0 switches the VESC's own command timeout off; ``timeout_brake_current`` [A] is
    what it applies afterwards, 0 being coasting.
    """

    signature: Annotated[int, "I"]
    controller_id: Annotated[int, "B"]
    timeout_ms: Annotated[int, "I"]
    timeout_brake_current: Single
    tail: bytes = b""


_APPCONF_FIELDS = wire_fields(AppConf)
_APPCONF_HEAD = 1 + sum(field.size for field in _APPCONF_FIELDS)


def decode_appconf(payload: bytes) -> AppConf | None:
    """Decode the head of an app configuration; None if it is cut or its brake current no number."""
    if len(payload) < _APPCONF_HEAD:
        return None
    values = unpack_fields(_APPCONF_FIELDS, payload, 1)
    if not math.isfinite(values["timeout_brake_current"]):
        return None
    return AppConf(**values, tail=payload[_APPCONF_HEAD:])


def encode_appconf(reply: AppConf) -> bytes:
    """GET_APPCONF reply."""
    head = pack_device(_APPCONF_FIELDS, reader(_APPCONF_FIELDS)(reply))
    return bytes((CommandId.GET_APPCONF,)) + head + reply.tail


@dataclass(frozen=True, slots=True)
class McConfTemp(Limits):
    """GET_MCCONF_TEMP reply: limits in force and the drive train."""

    motor_poles: Annotated[int, "B"]
    gear_ratio: Single
    wheel_diameter: Single

    @property
    def erpm_gain(self) -> float:
        """ERPM per m/s that these settings imply: ``60 * pole pairs * gear / (pi * D)``."""
        return 30 * self.motor_poles * self.gear_ratio / (math.pi * self.wheel_diameter)


LIMIT_FIELDS, _MCCONF_FIELDS = wire_fields(Limits), wire_fields(McConfTemp)


def decode_mcconf_temp(payload: bytes) -> McConfTemp | None:
    """Decode the limits in force; None if they are cut or one is no number."""
    values = unpack_fields(_MCCONF_FIELDS, payload, 1)
    whole = len(values) == len(_MCCONF_FIELDS) and all_finite(values)
    return McConfTemp(**values) if whole else None


def encode_mcconf_temp(reply: McConfTemp) -> bytes:
    """GET_MCCONF_TEMP reply."""
    body = pack_device(_MCCONF_FIELDS, reader(_MCCONF_FIELDS)(reply))
    return bytes((CommandId.GET_MCCONF_TEMP,)) + body


@dataclass(frozen=True, slots=True)
class Ack:
    """A bare id sent back: the command was carried out."""

    command: CommandId


_F32_EPSILON = 1e-6
_DUTY_MAX = 0.95  # largest duty cycle of a session


def make_session_limits(in_force: McConfTemp, erpm_max: float) -> SetMcConfTemp:
    """Limits for a session, `erpm_max` in either direction; never wider than those in force.

    Raises:
        ValueError: a limit is not positive and finite, so the car could not move.
    """
    if not 0.0 < erpm_max < math.inf:
        raise ValueError("session limits must be positive and finite")
    return replace(
        make_restored_limits(in_force),
        current_max_scale=min(in_force.current_max_scale, 1.0),
        erpm_min=max(in_force.erpm_min, -erpm_max),
        erpm_max=min(in_force.erpm_max, erpm_max),
        duty_max=min(in_force.duty_max, _DUTY_MAX),
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
