"""Payloads to commands and replies and back, for both ends of the link.

Host: `encode_command`, `decode_reply`. Device: `decode_command`, `encode_reply`. All take the
firmware, because ids from 10 up were one lower until 3.00 and layouts grew with every version.

A command is whole or does not exist: the firmware reads arguments without checking the length and
takes a short payload's CRC for data (`docs/reference/vesc-serial.md#v1.11`).
"""

from collections.abc import Callable
from functools import lru_cache
from typing import assert_never

from steerd.vesc_link import commands as c
from steerd.vesc_link import identity as i
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.commands import Command
from steerd.vesc_link.ids import FW_7_01, CommandId, Firmware, command_id, knows, wire_id
from steerd.vesc_link.wire import all_finite, pack_host, unpack_fields, wire_fields

Reply = t.Values | t.Uptime | t.Imu | i.FwVersion | i.AppConf | i.McConfTemp | i.Ack

_NUMBERS: dict[type[Command], CommandId] = {
    c.GetFwVersion: CommandId.FW_VERSION,
    c.GetValues: CommandId.GET_VALUES,
    c.SetDuty: CommandId.SET_DUTY,
    c.SetCurrent: CommandId.SET_CURRENT,
    c.SetCurrentBrake: CommandId.SET_CURRENT_BRAKE,
    c.SetErpm: CommandId.SET_RPM,
    c.SetServoPos: CommandId.SET_SERVO_POS,
    c.GetAppConf: CommandId.GET_APPCONF,
    c.Reboot: CommandId.REBOOT,
    c.Alive: CommandId.ALIVE,
    c.SetMcConfTemp: CommandId.SET_MCCONF_TEMP,
    c.GetValuesSelective: CommandId.GET_VALUES_SELECTIVE,
    c.GetValuesSetupSelective: CommandId.GET_VALUES_SETUP_SELECTIVE,
    c.GetImuData: CommandId.GET_IMU_DATA,
    c.GetMcConfTemp: CommandId.GET_MCCONF_TEMP,
}
_LAYOUTS = {kind: (number, wire_fields(kind)) for kind, number in _NUMBERS.items()}
_FLAGS = wire_fields(c.SetMcConfTemp)[len(i.LIMIT_FIELDS) :]
_LAYOUTS[c.SetMcConfTemp] = CommandId.SET_MCCONF_TEMP, (*_FLAGS, *i.LIMIT_FIELDS)
_BY_ID = {number: (kind, fields) for kind, (number, fields) in _LAYOUTS.items()}

FEEDS_TIMEOUT: tuple[type[Command], ...] = (
    c.SetDuty, c.SetCurrent, c.SetCurrentBrake, c.SetErpm, c.Alive,
)  # fmt: skip
"""Commands that restart the VESC's motor timeout; SET_SERVO_POS and polls do not."""
_UNANSWERED = frozenset((*FEEDS_TIMEOUT, c.SetServoPos, c.Reboot))


def command_number(command: Command) -> CommandId:
    """Id of a command, which is also the id of its reply."""
    return _NUMBERS[type(command)]


def expects_reply(command: Command) -> bool:
    """Whether the VESC answers with a frame of the same id."""
    if isinstance(command, c.SetMcConfTemp):
        return command.ack
    return type(command) not in _UNANSWERED


def encode_command(command: Command, firmware: Firmware = FW_7_01) -> bytes:
    """Payload of a command, numbers rounded half away from zero.

    Raises:
        ValueError: a value is NaN, infinite or out of range, or this firmware does not know the
            command.
    """
    number, fields = _LAYOUTS[type(command)]
    return _wire_byte(number, firmware) + pack_host(fields, command)


def decode_command(payload: bytes, firmware: Firmware = FW_7_01) -> Command | None:
    """Command in a payload, as a device of this firmware understands it.

    Returns None for an empty or short payload, for an id that the firmware does not know and for
    a number that is not finite. (The real firmware obeys a short one, with the CRC for its
    argument; no simulation should.)
    """
    number = command_id(payload[0], firmware) if payload else None
    if number is None or number not in _BY_ID or not knows(firmware, number):
        return None
    kind, fields = _BY_ID[number]
    values = unpack_fields(fields, payload, 1)
    if len(values) < len(fields) or not all_finite(values):
        return None
    return kind(**values)


_REPLIES: dict[CommandId, Callable[[bytes], Reply | None]] = {
    CommandId.GET_VALUES: t.decode_values,
    CommandId.GET_VALUES_SELECTIVE: t.decode_values_selective,
    CommandId.GET_VALUES_SETUP_SELECTIVE: t.decode_uptime,
    CommandId.GET_IMU_DATA: t.decode_imu,
    CommandId.FW_VERSION: i.decode_fw_version,
    CommandId.GET_APPCONF: i.decode_appconf,
    CommandId.GET_MCCONF_TEMP: i.decode_mcconf_temp,
    CommandId.SET_MCCONF_TEMP: lambda payload: i.Ack(CommandId.SET_MCCONF_TEMP),
}


def decode_reply(payload: bytes, firmware: Firmware = FW_7_01) -> Reply | None:
    """Reply in a payload; None for an id that is no reply we know, or a reply too short to use."""
    number = command_id(payload[0], firmware) if payload else None
    return None if number is None else decode_numbered(number, payload)


def decode_numbered(number: CommandId, payload: bytes) -> Reply | None:
    """`decode_reply` of a payload whose id is known already."""
    decode = _REPLIES.get(number)
    return decode(payload) if decode else None


def encode_reply(reply: Reply, firmware: Firmware = FW_7_01) -> bytes:
    """Payload of a reply as a device of this firmware sends it: single precision, truncated.

    Raises:
        ValueError: a number is NaN or infinite, or this firmware has no such reply.
    """
    match reply:
        case t.Values():
            payload = t.encode_values(reply, firmware)
        case t.Uptime():
            payload = t.encode_uptime(reply, firmware)
        case t.Imu():
            payload = t.encode_imu(reply, firmware)
        case i.FwVersion():
            payload = i.encode_fw_version(reply, firmware)
        case i.AppConf():
            payload = i.encode_appconf(reply)
        case i.McConfTemp():
            payload = i.encode_mcconf_temp(reply)
        case i.Ack():
            payload = bytes((reply.command,))
        case _:
            assert_never(reply)
    return _wire_byte(payload[0], firmware) + payload[1:]


@lru_cache(maxsize=256)
def _wire_byte(number: int, firmware: Firmware) -> bytes:
    return bytes((wire_id(CommandId(number), firmware),))
