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
from steerd.vesc_link.wire import (
    Field,
    all_finite,
    device_numbers,
    host_numbers,
    pack_fields,
    read_values,
    unpack_fields,
)

Reply = (
    t.Values | t.ValuesSetup | t.Imu | t.Stats | i.FwVersion | i.AppConf | i.McConfTemp
    | i.BatteryCut | i.DecodedPpm | i.RotorPosition | i.Print | i.CanIds | i.Ack
)  # fmt: skip

_FLAGS = tuple(
    Field(name, "?") for name in ("store", "forward_can", "ack", "divide_by_controllers")
)
_LAYOUTS: dict[type[Command], tuple[CommandId, tuple[Field, ...]]] = {
    c.GetFwVersion: (CommandId.FW_VERSION, ()),
    c.GetValues: (CommandId.GET_VALUES, ()),
    c.SetDuty: (CommandId.SET_DUTY, (Field("duty", "i", 1e5),)),
    c.SetCurrent: (CommandId.SET_CURRENT, (Field("current", "i", 1e3),)),
    c.SetCurrentBrake: (CommandId.SET_CURRENT_BRAKE, (Field("current", "i", 1e3),)),
    c.SetErpm: (CommandId.SET_RPM, (Field("erpm", "i", 1e0),)),
    c.SetPos: (CommandId.SET_POS, (Field("pos_deg", "i", 1e6),)),
    c.SetHandbrake: (CommandId.SET_HANDBRAKE, (Field("current", "i", 1e3),)),
    c.SetDetect: (CommandId.SET_DETECT, (Field("mode", "B"),)),
    c.SetServoPos: (CommandId.SET_SERVO_POS, (Field("servo_pos", "h", 1e3),)),
    c.GetMcConf: (CommandId.GET_MCCONF, ()),
    c.GetMcConfDefault: (CommandId.GET_MCCONF_DEFAULT, ()),
    c.GetAppConf: (CommandId.GET_APPCONF, ()),
    c.GetAppConfDefault: (CommandId.GET_APPCONF_DEFAULT, ()),
    c.TerminalCommand: (CommandId.TERMINAL_CMD, ()),
    c.Reboot: (CommandId.REBOOT, ()),
    c.Alive: (CommandId.ALIVE, ()),
    c.GetDecodedPpm: (CommandId.GET_DECODED_PPM, ()),
    c.ForwardCan: (CommandId.FORWARD_CAN, (Field("can_id", "B"),)),
    c.GetValuesSetup: (CommandId.GET_VALUES_SETUP, ()),
    c.SetMcConfTemp: (CommandId.SET_MCCONF_TEMP, (*_FLAGS, *i.LIMIT_FIELDS)),
    c.GetValuesSelective: (CommandId.GET_VALUES_SELECTIVE, (Field("mask", "I"),)),
    c.GetValuesSetupSelective: (CommandId.GET_VALUES_SETUP_SELECTIVE, (Field("mask", "I"),)),
    c.PingCan: (CommandId.PING_CAN, ()),
    c.AppDisableOutput: (
        CommandId.APP_DISABLE_OUTPUT,
        (Field("forward_can", "?"), Field("duration_ms", "i")),
    ),
    c.GetImuData: (CommandId.GET_IMU_DATA, (Field("mask", "H"),)),
    c.SetCurrentRel: (CommandId.SET_CURRENT_REL, (Field("ratio", "i", 1e5),)),
    c.GetMcConfTemp: (CommandId.GET_MCCONF_TEMP, ()),
    c.GetBatteryCut: (CommandId.GET_BATTERY_CUT, ()),
    c.GetStats: (CommandId.GET_STATS, (Field("mask", "H"),)),
    c.ResetStats: (CommandId.RESET_STATS, (Field("ack", "?"),)),
    c.MotorEstop: (CommandId.MOTOR_ESTOP, (Field("duration_ms", "H"),)),
}
_BY_ID = {number: (kind, fields) for kind, (number, fields) in _LAYOUTS.items()}
_OPTIONAL = {CommandId.SET_MCCONF_TEMP: 2, CommandId.RESET_STATS: 1}
"""How many fields at the end the firmware lets a sender leave out."""

FEEDS_TIMEOUT: tuple[type[Command], ...] = (
    c.SetDuty, c.SetCurrent, c.SetCurrentBrake, c.SetErpm, c.SetPos, c.SetHandbrake,
    c.SetCurrentRel, c.Alive,
)  # fmt: skip
"""Commands that restart the VESC's motor timeout; SET_SERVO_POS and polls do not."""
_ANSWERED: frozenset[type[Command]] = frozenset((
    c.GetFwVersion, c.GetValues, c.GetMcConf, c.GetMcConfDefault, c.GetAppConf,
    c.GetAppConfDefault, c.GetDecodedPpm, c.GetValuesSetup, c.GetValuesSelective,
    c.GetValuesSetupSelective, c.PingCan, c.GetImuData, c.GetMcConfTemp, c.GetBatteryCut,
    c.GetStats,
))  # fmt: skip
_ACKS = (c.SetMcConfTemp, c.ResetStats)


def command_number(command: Command) -> CommandId:
    """Id of a command, which is also the id of its reply."""
    return _LAYOUTS[type(command)][0]


def expects_reply(command: Command) -> bool:
    """Whether the VESC answers with a frame of the same id."""
    if isinstance(command, _ACKS):
        return command.ack
    return type(command) in _ANSWERED


def encode_command(command: Command, firmware: Firmware = FW_7_01) -> bytes:
    """Payload of a command, numbers rounded half away from zero.

    Raises:
        ValueError: a value is missing, NaN, infinite or out of range, or this firmware does not
            know the command.
    """
    number, fields = _LAYOUTS[type(command)]
    values = read_values(fields, command)
    payload = bytes((wire_id(number, firmware),)) + pack_fields(fields, values, host_numbers)
    if isinstance(command, c.TerminalCommand):
        if "\0" in command.text:
            raise ValueError("a terminal command holds no NUL")
        return payload + command.text.encode("ascii")
    if isinstance(command, c.ForwardCan):
        if not command.inner:
            raise ValueError("a forwarded command holds at least its id")
        return payload + command.inner
    return payload


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
    if number is CommandId.TERMINAL_CMD:
        return c.TerminalCommand(payload[1:].split(b"\0")[0].decode("ascii", "replace"))
    if number is CommandId.FORWARD_CAN:
        return c.ForwardCan(payload[1], payload[2:]) if len(payload) > 2 else None
    values, _ = unpack_fields(fields, payload, 1)
    if len(values) < len(fields) - _OPTIONAL.get(number, 0) or not all_finite(values):
        return None
    if number is CommandId.SET_MCCONF_TEMP:
        values = {"input_current_min": None, "input_current_max": None, **values}
    return kind(**values)


def _decode_print(payload: bytes) -> i.Print:
    return i.Print(payload[1:].decode("utf-8", "replace"))


def _decode_can_ids(payload: bytes) -> i.CanIds:
    return i.CanIds(tuple(payload[1:]))


_REPLIES: dict[CommandId, Callable[[bytes], Reply | None]] = {
    CommandId.GET_VALUES: t.decode_values,
    CommandId.GET_VALUES_SELECTIVE: t.decode_values_selective,
    CommandId.GET_VALUES_SETUP: t.decode_setup,
    CommandId.GET_VALUES_SETUP_SELECTIVE: t.decode_setup_selective,
    CommandId.GET_IMU_DATA: t.decode_imu,
    CommandId.GET_STATS: t.decode_stats,
    CommandId.FW_VERSION: i.decode_fw_version,
    CommandId.GET_APPCONF: i.decode_appconf,
    CommandId.PRINT: _decode_print,
    CommandId.PING_CAN: _decode_can_ids,
}
_ACKED = frozenset(
    (CommandId.SET_MCCONF, CommandId.SET_APPCONF, CommandId.SET_MCCONF_TEMP, CommandId.RESET_STATS)
)


def decode_reply(payload: bytes, firmware: Firmware = FW_7_01) -> Reply | None:
    """Reply in a payload; None for an id that is no reply we know, or a reply too short to use."""
    number = command_id(payload[0], firmware) if payload else None
    return None if number is None else decode_numbered(number, payload)


def decode_numbered(number: CommandId, payload: bytes) -> Reply | None:
    """`decode_reply` of a payload whose id is known already."""
    if number in _ACKED:
        return i.Ack(number)
    if number in i.SMALL_REPLIES:
        kind, fields = i.SMALL_REPLIES[number]
        values, _ = unpack_fields(fields, payload, 1)
        return kind(**values) if len(values) == len(fields) and all_finite(values) else None
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
        case t.ValuesSetup():
            payload = t.encode_setup(reply, firmware)
        case t.Imu():
            payload = t.encode_imu(reply, firmware)
        case t.Stats():
            payload = t.encode_stats(reply, firmware)
        case i.FwVersion():
            payload = i.encode_fw_version(reply, firmware)
        case i.AppConf():
            payload = i.encode_appconf(reply)
        case i.McConfTemp() | i.BatteryCut() | i.DecodedPpm() | i.RotorPosition():
            payload = _encode_small(reply)
        case i.Print():
            payload = bytes((CommandId.PRINT,)) + reply.text.encode()
        case i.CanIds():
            payload = bytes((CommandId.PING_CAN, *reply.ids))
        case i.Ack():
            payload = bytes((reply.command,))
        case _:
            assert_never(reply)
    return _wire_byte(payload[0], firmware) + payload[1:]


@lru_cache(maxsize=256)
def _wire_byte(number: int, firmware: Firmware) -> bytes:
    return bytes((wire_id(CommandId(number), firmware),))


def _encode_small(reply: i.McConfTemp | i.BatteryCut | i.DecodedPpm | i.RotorPosition) -> bytes:
    number, fields = next((n, f) for n, (k, f) in i.SMALL_REPLIES.items() if isinstance(reply, k))
    return bytes((number,)) + pack_fields(fields, read_values(fields, reply), device_numbers)
