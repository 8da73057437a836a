"""Which question the simulated VESC answers with which reply."""

from collections.abc import Callable
from typing import Any, Protocol

from steerd.sim_hw.vesc.vesc_config import VescConfig
from steerd.sim_hw.vesc.vesc_motor import Motor
from steerd.sim_hw.vesc.vesc_power import Power
from steerd.sim_hw.vesc.vesc_replies import (
    ImuChip,
    Statistics,
    make_appconf,
    make_fw_version,
    make_mcconf_temp,
    make_setup,
    make_values,
)
from steerd.vesc_link import commands as c
from steerd.vesc_link.identity import Ack, BatteryCut, DecodedPpm
from steerd.vesc_link.ids import CommandId
from steerd.vesc_link.packets import Reply


class Vesc(Protocol):
    """The parts of a simulated VESC that answers are made of."""

    config: VescConfig
    motor: Motor
    power: Power
    stats: Statistics
    imu: ImuChip
    boot_ns: int

    @property
    def uuid(self) -> bytes:
        """Its identity."""

    def reported_erpm(self) -> int:
        """ERPM as telemetry says it."""


Answer = Callable[[Vesc, int, Any], Reply | None]


def _values(vesc: Vesc, t_ns: int, command: Any) -> Reply:
    mask = getattr(command, "mask", None)
    return make_values(vesc.config, vesc.motor, vesc.power, vesc.reported_erpm(), mask)


def _setup(vesc: Vesc, t_ns: int, command: Any) -> Reply:
    mask, uptime_ns = getattr(command, "mask", None), t_ns - vesc.boot_ns
    parts = (vesc.config, vesc.motor, vesc.power)
    return make_setup(*parts, vesc.reported_erpm(), uptime_ns, mask)


def _set_limits(vesc: Vesc, t_ns: int, command: c.SetMcConfTemp) -> Reply | None:
    limits = vesc.motor.limits
    for name in limits:
        value = getattr(command, name)
        if value is not None:
            limits[name] = value
    return Ack(CommandId.SET_MCCONF_TEMP) if command.ack else None


def _reset_stats(vesc: Vesc, t_ns: int, command: c.ResetStats) -> Reply | None:
    vesc.stats.reset(t_ns)
    return Ack(CommandId.RESET_STATS) if command.ack else None


def _battery_cut(vesc: Vesc, t_ns: int, command: c.GetBatteryCut) -> Reply:
    lowest = vesc.config.voltage_min
    return BatteryCut(lowest + 1.5, lowest + 0.5)


ANSWERS: dict[type[c.Command], Answer] = {
    c.GetFwVersion: lambda vesc, t_ns, _: make_fw_version(vesc.config, vesc.uuid),
    c.GetValues: _values,
    c.GetValuesSelective: _values,
    c.GetValuesSetup: _setup,
    c.GetValuesSetupSelective: _setup,
    c.GetAppConf: lambda vesc, t_ns, _: make_appconf(vesc.config, vesc.motor),
    c.GetMcConfTemp: lambda vesc, t_ns, _: make_mcconf_temp(vesc.config, vesc.motor),
    c.SetMcConfTemp: _set_limits,
    c.GetImuData: lambda vesc, t_ns, command: vesc.imu.make_reply(command.mask, t_ns),
    c.GetStats: lambda vesc, t_ns, command: vesc.stats.make_reply(command.mask, t_ns),
    c.ResetStats: _reset_stats,
    c.GetBatteryCut: _battery_cut,
    c.GetDecodedPpm: lambda vesc, t_ns, _: DecodedPpm(0.0, 0.0),
}
"""Commands with a reply at once; None where none is requested."""
