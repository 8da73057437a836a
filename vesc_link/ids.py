"""Names and numbers of the VESC protocol: command ids, firmware versions, fault codes.

Source: `docs/reference/vesc-serial.md#v2`, `docs/reference/vesc-serial.md#v2.4` and
`docs/reference/vesc-serial.md#v2.5`.
"""

from enum import IntEnum
from typing import NamedTuple


class Firmware(NamedTuple):
    """Firmware version; the minor part is a plain number, so 5.02 is ``(5, 2)``."""

    major: int
    minor: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor:02d}"


ALWAYS = Firmware(0, 0)
"""Since the first firmware there was."""
FW_3_00 = Firmware(3, 0)
"""Last firmware with the old telemetry table and the old numbers of the ids."""
FW_3_40 = Firmware(3, 40)
FW_3_60 = Firmware(3, 60)
FW_5_02 = Firmware(5, 2)
FW_5_03 = Firmware(5, 3)
FW_6_00 = Firmware(6, 0)
FW_6_05 = Firmware(6, 5)
FW_7_01 = Firmware(7, 1)
PROFILES = (FW_3_40, FW_3_60, FW_5_02, FW_5_03, FW_6_00, FW_6_05, FW_7_01)
"""Firmware versions that the simulated VESC speaks."""


class CommandId(IntEnum):
    """First payload byte of what steerd sends or reads, as since firmware 3.07 (see `wire_id`)."""

    FW_VERSION = 0
    GET_VALUES = 4
    SET_DUTY = 5
    SET_CURRENT = 6
    SET_CURRENT_BRAKE = 7
    SET_RPM = 8
    SET_SERVO_POS = 12
    GET_APPCONF = 17
    REBOOT = 29
    ALIVE = 30
    SET_MCCONF_TEMP = 48
    GET_VALUES_SELECTIVE = 50
    GET_VALUES_SETUP_SELECTIVE = 51
    GET_IMU_DATA = 65
    GET_MCCONF_TEMP = 91


SINCE: dict[CommandId, Firmware] = {
    CommandId.SET_MCCONF_TEMP: Firmware(3, 48),
    CommandId.GET_VALUES_SELECTIVE: Firmware(3, 48),
    CommandId.GET_VALUES_SETUP_SELECTIVE: Firmware(3, 48),
    CommandId.GET_IMU_DATA: Firmware(3, 52),
    CommandId.GET_MCCONF_TEMP: Firmware(5, 2),
}
"""First firmware that knows the command; ids not listed are in all of them."""
_HANDBRAKE = 10
"""SET_HANDBRAKE, which came with firmware 3.07 and moved all behind it up by one."""


def knows(firmware: Firmware, command: CommandId) -> bool:
    """Whether this firmware understands the command."""
    return firmware >= SINCE.get(command, ALWAYS)


def wire_id(command: CommandId, firmware: Firmware) -> int:
    """Id byte on the wire: up to 3.00 there was no SET_HANDBRAKE, so ids from 10 were one lower.

    Raises:
        ValueError: this firmware does not know the command.
    """
    if not knows(firmware, command):
        raise ValueError(f"{command.name} needs firmware {SINCE[command]}, this is {firmware}")
    return command - 1 if firmware <= FW_3_00 and command > _HANDBRAKE else command


def command_id(wire: int, firmware: Firmware) -> CommandId | None:
    """Inverse of `wire_id`; None when no command that we know has this number."""
    number = wire + 1 if firmware <= FW_3_00 and wire >= _HANDBRAKE else wire
    return _KNOWN.get(number)


_KNOWN = {int(command): command for command in CommandId}

FAULT_NAMES = (
    "NONE", "OVER_VOLTAGE", "UNDER_VOLTAGE", "DRV", "ABS_OVER_CURRENT", "OVER_TEMP_FET",
    "OVER_TEMP_MOTOR", "GATE_DRIVER_OVER_VOLTAGE", "GATE_DRIVER_UNDER_VOLTAGE",
    "MCU_UNDER_VOLTAGE", "BOOTING_FROM_WATCHDOG_RESET", "ENCODER_SPI",
    "ENCODER_SINCOS_BELOW_MIN_AMPLITUDE", "ENCODER_SINCOS_ABOVE_MAX_AMPLITUDE",
    "FLASH_CORRUPTION", "HIGH_OFFSET_CURRENT_SENSOR_1", "HIGH_OFFSET_CURRENT_SENSOR_2",
    "HIGH_OFFSET_CURRENT_SENSOR_3", "UNBALANCED_CURRENTS", "BRK", "RESOLVER_LOT", "RESOLVER_DOS",
    "RESOLVER_LOS", "FLASH_CORRUPTION_APP_CFG", "FLASH_CORRUPTION_MC_CFG", "ENCODER_NO_MAGNET",
    "ENCODER_MAGNET_TOO_STRONG", "PHASE_FILTER", "ENCODER_FAULT", "LV_OUTPUT_FAULT",
    "ENCODER_SLIP", "OVERSPEED", "UNDERSPEED", "ABS_OVERSPEED",
)  # fmt: skip
"""Fault names by code; the firmware's list only ever grows at its end."""
FAULT_WATCHDOG_BOOT = FAULT_NAMES.index("BOOTING_FROM_WATCHDOG_RESET")


def fault_name(code: int) -> str:
    """Name of a fault code; ``FAULT_<n>`` for one that is newer than this table."""
    return FAULT_NAMES[code] if 0 <= code < len(FAULT_NAMES) else f"FAULT_{code}"
