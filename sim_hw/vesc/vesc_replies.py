"""What the simulated VESC says of itself: its state as the reply values of `vesc_link`."""

import math
from typing import Any

from steerd.sim_hw.plant.car import SimCar
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.sim_hw.vesc.vesc_config import MS, VescConfig
from steerd.sim_hw.vesc.vesc_motor import Motor
from steerd.sim_hw.vesc.vesc_power import MEANS, Power
from steerd.vesc_link import identity, telemetry
from steerd.vesc_link.ids import fault_name

_IMU_PERIOD_NS = 5 * MS
"""The firmware samples its IMU at 200 Hz; faster polling reads the same sample again."""
_MEAN_BITS = {"motor_current": 2, "input_current": 3, "d_current": 4, "q_current": 5}
_MEAN_BITS |= {"v_d": 19, "v_q": 20}
_SIGNATURE = 0x2A1B5C03
_APPCONF_TAIL = bytes(range(1, 200)) * 2
"""Stands for the rest of the app configuration, whose layout changes with every firmware."""


def make_values(
    config: VescConfig, motor: Motor, power: Power, erpm: float, mask: int | None
) -> telemetry.Values:
    """GET_VALUES reply; reads, and thereby restarts, the requested means.

    What no client of ours asks for (charge, energy, position, temperature of each switch) is 0.
    """
    temp = power.temp_c
    asked = [name for name in MEANS if mask is None or mask >> _MEAN_BITS[name] & 1]
    means: dict[str, Any] = power.read_means(asked)
    return telemetry.Values(
        **means,
        temp_fet_c=temp,
        temp_motor_c=temp,
        duty=power.duty,
        erpm=erpm,
        input_voltage=power.voltage,
        tachometer=power.tachometer,
        tachometer_abs=power.tachometer_abs,
        fault=motor.fault,
        controller_id=config.controller_id,
        status=motor.status,
        mask=mask,
    )


def make_fw_version(config: VescConfig, uuid: bytes) -> identity.FwVersion:
    """FW_VERSION reply."""
    return identity.FwVersion(
        *config.firmware, hw_name=config.hw_name, uuid=uuid, paired=0, hw_config_crc=0xDEADBEEF
    )


def make_appconf(config: VescConfig, motor: Motor) -> identity.AppConf:
    """GET_APPCONF reply: timeout and its brake current, then a tail that no one should read."""
    return identity.AppConf(
        _SIGNATURE,
        config.controller_id,
        motor.timeout_ms,
        motor.timeout_brake_current,
        _APPCONF_TAIL,
    )


def make_mcconf_temp(config: VescConfig, motor: Motor) -> identity.McConfTemp:
    """GET_MCCONF_TEMP reply: the limits in force."""
    return identity.McConfTemp(
        **motor.limits,
        motor_poles=config.motor_poles,
        gear_ratio=config.gear_ratio,
        wheel_diameter=config.wheel_diameter,
    )


def make_terminal_answer(motor: Motor, text: str) -> identity.Print:
    """What the terminal prints."""
    if text == "faults":
        return identity.Print(f"Fault: FAULT_CODE_{fault_name(motor.fault)}")
    return identity.Print(f"Invalid command: {text}")


class ImuChip:
    """The board's IMU: gyro and accelerometer of the car with noise, attitude from its yaw."""

    def __init__(self, config: VescConfig, car: SimCar, noise: NoiseSource) -> None:
        self._config = config
        self._car = car
        self._noise = noise
        self._yaw_start = car.state.yaw
        self._sample_ns = -1
        self._sample: dict[str, Any] = {}

    def make_reply(self, mask: int, t_ns: int) -> telemetry.Imu:
        """GET_IMU_DATA reply: the latest 200 Hz sample; without a chip zeros and identity."""
        if not self._config.imu:
            return telemetry.Imu(mask, q_w=1.0, controller_id=self._config.controller_id)
        slot = t_ns // _IMU_PERIOD_NS
        if slot != self._sample_ns:
            self._sample_ns = slot
            self._sample = self._measure()
        return telemetry.Imu(mask, **self._sample, controller_id=self._config.controller_id)

    def _measure(self) -> dict[str, float]:
        car = self._car
        gyro, accel = self._config.gyro_noise, self._config.accel_noise
        drawn = self._noise.normals(6)
        yaw = car.state.yaw - self._yaw_start
        return {
            "yaw": -math.remainder(yaw, math.tau),  # the firmware's sign
            "accel_x": car.accel_x + accel * drawn[0],
            "accel_y": car.accel_y + accel * drawn[1],
            "accel_z": telemetry.STANDARD_GRAVITY + accel * drawn[2],
            "gyro_x": gyro * drawn[3],
            "gyro_y": gyro * drawn[4],
            "gyro_z": car.observe_motor().yaw_rate + gyro * drawn[5],
            "q_w": math.cos(yaw / 2.0),
            "q_z": math.sin(yaw / 2.0),
        }
