"""The simulated VESC: bytes of the serial link in and out, wheels and servo of the car driven.

It uses the firmware's own parser (head-of-line blocking included) and `vesc_link`'s codec. What is
modelled is the list of `docs/reference/vesc-serial.md#v8`; each item has a test that names it.
"""

import math
from collections import deque
from contextlib import suppress
from functools import lru_cache
from typing import Any

from steerd.sim_hw.plant.car import COAST, Demand, Drive, SimCar
from steerd.sim_hw.plant.faults import HEALTHY_VESC, VescFaultState
from steerd.sim_hw.plant.noise import NoiseSource
from steerd.sim_hw.vesc.vesc_motor import MEANS, MS, Mode, Motor, Power, VescConfig, duty_current
from steerd.sim_hw.vesc.vesc_wire import FALSE_HEADER, Chunk, Logged, ReplyWire
from steerd.vesc_link import commands as c
from steerd.vesc_link import ids, telemetry
from steerd.vesc_link.frames import FrameParser
from steerd.vesc_link.identity import LIMIT_FIELDS, Ack, AppConf, FwVersion, McConfTemp
from steerd.vesc_link.packets import FEEDS_TIMEOUT, Reply, decode_command, encode_reply
from steerd.vesc_link.scaling import Scaling, erpm_to_speed, servo_pos_to_steer
from steerd.vesc_link.telemetry import UPTIME_MASK, Uptime

_IMU_PERIOD_NS = 5 * MS
"""The firmware samples its IMU at 200 Hz; faster polling reads the same sample again."""
_SIGNATURE = 0x2A1B5C03
_VERSION_TAIL = bytes(9) + bytes.fromhex("deadbeef")
_VERSION_TAILS = (((3, 48), 1), ((5, 0), 2), ((5, 2), 4), ((5, 3), 7), ((6, 0), 9), ((6, 5), 13))
"""Firmware versions since which the version reply has a tail of so many bytes."""
_APPCONF_TAIL = bytes(range(1, 200)) * 2
"""Stands for the rest of the app configuration, whose layout changes with every firmware."""


def make_values(
    config: VescConfig, motor: Motor, power: Power, erpm: float, mask: int | None
) -> telemetry.Values:
    """GET_VALUES reply; reads, and thereby restarts, the requested means.

    What no client of ours asks for (charge, energy, position, temperature of each switch) is 0.
    """
    temp = power.temp_c
    asked = [name for name, bit in MEANS.items() if mask is None or mask >> bit & 1]
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


def make_fw_version(config: VescConfig, uuid: bytes) -> FwVersion:
    """FW_VERSION reply; its tail is as long as this firmware's."""
    size = max((size for since, size in _VERSION_TAILS if config.firmware >= since), default=0)
    return FwVersion(*config.firmware, config.hw_name, uuid, _VERSION_TAIL[:size])


_UNDER_VOLTAGE = ids.FAULT_NAMES.index("UNDER_VOLTAGE")
_OVER_TEMP = ids.FAULT_NAMES.index("OVER_TEMP_FET")
_PARSER_512 = ids.Firmware(3, 48)
_OLDER = ids.FW_3_40
_decode = lru_cache(maxsize=512)(decode_command)


def make_parser(firmware: ids.Firmware) -> FrameParser:
    """The receiver of this firmware: longest payload and patience with a silent sender."""
    if firmware < _PARSER_512:
        return FrameParser(max_payload=1024, strict=True, gap_ns=2 * MS)
    gap_ns = None if firmware >= ids.FW_5_03 else 1000 * MS
    return FrameParser(strict=True, gap_ns=gap_ns)


class SimVesc:
    """One VESC on one car: `step` once per physics step, `on_bytes` and `read` at any time."""

    def __init__(
        self,
        config: VescConfig,
        scaling: Scaling,
        car: SimCar,
        noise: NoiseSource,
        log: list[Logged] | None = None,
    ) -> None:
        self.config = config
        self.car = car
        self._log = log  # takes every byte with its time
        self.fault_state: VescFaultState = HEALTHY_VESC
        self._scaling = scaling
        self._sign = -1 if config.invert else 1
        self._noise = noise
        self._wire = ReplyWire(config, noise, log)
        self._held: deque[Chunk] = deque()
        self._off_until_ns = -1
        self.connected = True  # whether the host sees the USB device
        self._stuck_erpm: int | None = None
        self._boot(car.t_ns, config.uptime_ns)

    def _boot(self, t_ns: int, uptime_ns: int = 0) -> None:
        config = self.config
        self.motor = Motor(config, t_ns - uptime_ns)  # modes, timeout, faults
        self.motor.fault_state = self.fault_state
        self.power = Power(config)  # electrical measurements
        self.power.heat(self.fault_state.heat_c)
        self._yaw_start = self.car.state.yaw
        self._imu_slot = -1
        self._imu: dict[str, Any] = {}
        self._parser = make_parser(config.firmware)
        self.boot_ns = t_ns - uptime_ns  # when it came up
        self._servo_target = self._servo_out = 0.5
        self._servo_steer = servo_pos_to_steer(self._scaling, self._servo_out)
        self._servo_next_ns = t_ns + config.servo_phase_ns
        self._alive_next_ns = t_ns

    # --- faults

    def set_fault_state(self, t_ns: int, faults: VescFaultState) -> None:
        """From ``t_ns`` on, be in this condition."""
        before, self.fault_state = self.fault_state, faults
        self.connected = faults.plugged and self._off_until_ns < 0
        self.motor.fault_state = self._wire.fault_state = faults
        self.power.heat(faults.heat_c)
        if faults.plugged != before.plugged:
            self._wire.reset()
            self._held.clear()
        if faults.reboot and not before.reboot:
            self.reboot(t_ns)
        if faults.fault_once and not before.fault_once:
            self.motor.hold_fault(t_ns, faults.fault_once)
        if faults.false_header and not before.false_header:
            self._wire.send_raw(t_ns, FALSE_HEADER)
        if not faults.erpm_stuck:
            self._stuck_erpm = None

    def reboot(self, t_ns: int) -> None:
        """Lose power and come back: USB is gone for a while, everything in RAM is forgotten."""
        self._wire.reset()
        self._held.clear()
        self._off_until_ns = t_ns + self.config.reboot_ns
        self.connected = False
        self.motor.release()

    @property
    def uuid(self) -> bytes:
        """Its identity."""
        return self.config.uuid if self.fault_state.uuid is None else self.fault_state.uuid

    # --- the wheels

    def step(self, t_ns: int, h: float) -> tuple[float, Demand]:
        """Live through a physics step of ``h`` seconds.

        Returns:
            The servo's angle as road-wheel angle [rad] and what the motor asks of the wheels.
        """
        if self._off_until_ns >= 0:
            if t_ns < self._off_until_ns:
                return self._servo_steer, COAST
            self._off_until_ns = -1
            self.connected = self.fault_state.plugged
            self._boot(t_ns)
        faults, power, config = self.fault_state, self.power, self.config
        if self._held or faults.alive_ns:
            self._catch_up(t_ns)
        if faults.fault_code:
            self.motor.hold_fault(t_ns, faults.fault_code)
        if power.voltage < config.voltage_min:
            self.motor.hold_fault(t_ns, _UNDER_VOLTAGE)
        if power.temp_c > config.temp_limit_c:
            self.motor.hold_fault(t_ns, _OVER_TEMP)
        erpm = self._true_erpm()
        demand, current = self._act(*self.motor.step(t_ns, h), erpm)
        power.step(current, erpm, h, faults.sag)
        return self._servo(t_ns), demand

    def _servo(self, t_ns: int) -> float:
        """The road-wheel angle [rad] that the servo holds now; faults of servos replace this.

        A new one takes effect with the pulse that is due; without output it never does.
        """
        config = self.config
        if t_ns < self._servo_next_ns or not config.servo_out or self.fault_state.servo_dead:
            return self._servo_steer
        self._servo_out = self._servo_target
        self._servo_steer = servo_pos_to_steer(self._scaling, self._servo_out)
        if config.servo_frame_ns:
            behind = (t_ns - self._servo_next_ns) // config.servo_frame_ns
            self._servo_next_ns += config.servo_frame_ns * (behind + 1)
        return self._servo_steer

    def _act(self, mode: Mode, value: float, erpm: float) -> tuple[Demand, float]:
        """The demand for the wheels and the motor current [A, wire sign]."""
        gain = self.config.accel_per_amp
        if mode is Mode.SPEED:
            speed = erpm_to_speed(self._scaling, value * self._sign)
            drag = self.car.setup.coast_decel if self.car.speed > 0.0 else 0.0
            return Demand(Drive.SPEED, speed), self._sign * (self.car.accel_x + drag) / gain
        if mode is Mode.BRAKE:
            current = -value if erpm > 0.0 else value if erpm < 0.0 else 0.0
            return Demand(Drive.BRAKE, value * gain), current
        if mode is Mode.RELEASED:
            return COAST, 0.0
        if mode is Mode.DUTY:
            value = duty_current(self.config, value, self.power.voltage, erpm)
        return Demand(Drive.FORCE, value * gain * self._sign), value

    def _true_erpm(self) -> float:
        scaling = self._scaling
        wheel = self.car.wheel_speed
        return self._sign * (scaling.erpm_gain * wheel + scaling.erpm_offset * (wheel != 0.0))

    # --- the wire

    @property
    def next_wake_ns(self) -> int | None:
        """When bytes are due at the latest, or what the host sees may change.

        Where it is off, or behind with its orders, the next physics step may change that.
        """
        due = self._wire.next_ns
        if self._held or self._off_until_ns >= 0:
            step_ns = self.car.t_ns + self.car.setup.step_ns
            due = step_ns if due is None or step_ns < due else due
        return due

    def on_bytes(self, t_ns: int, data: bytes) -> None:
        """Take bytes from the host."""
        if not self.connected:
            return
        if self._log is not None:
            self._log.append(Logged(t_ns, "vesc", data))
        if t_ns < self._wire.blocked_until_ns:
            self._held.append((t_ns, data))
            return
        self._catch_up(t_ns)
        self._receive(t_ns, data)

    def _catch_up(self, t_ns: int) -> None:
        while self._held and t_ns >= self._wire.blocked_until_ns:
            self._receive(t_ns, self._held.popleft()[1])
        period = self.fault_state.alive_ns
        if period and t_ns >= self._alive_next_ns:
            self._alive_next_ns = t_ns + period
            self.motor.feed(t_ns)

    def _receive(self, t_ns: int, data: bytes) -> None:
        for payload in self._parser.feed(data, t_ns):
            self._obey(t_ns, payload)

    def read(self, t_ns: int) -> bytes:
        """What is due by ``t_ns``, read by the host; one that never reads blocks the VESC."""
        due = self._wire.next_ns
        if not self.connected or due is None or due > t_ns:
            return b""
        return self._wire.read(t_ns)

    # --- commands

    def _obey(self, t_ns: int, payload: bytes) -> None:
        """Carry out a command; what is none, or lacks its arguments, changes nothing."""
        command = _decode(payload, self.config.firmware)
        if command is None:
            return
        if type(command) in FEEDS_TIMEOUT:
            self.motor.command(t_ns, command, self._true_erpm())
        elif (reply := self._answer(t_ns, command)) is not None:
            self._reply(t_ns, reply)

    def _answer(self, t_ns: int, command: c.Command) -> Reply | None:
        """Carry out a command that is no motor's; what it says at once, if anything."""
        config, motor = self.config, self.motor
        match command:
            case c.SetServoPos():
                self._servo_target = min(max(command.servo_pos, 0.0), 1.0)
            case c.GetValuesSelective(mask=mask):
                return make_values(config, motor, self.power, self.reported_erpm(), mask)
            case c.GetImuData(mask=mask):
                return self._read_imu(mask, t_ns)
            case c.GetValues():
                return make_values(config, motor, self.power, self.reported_erpm(), None)
            case c.GetValuesSetupSelective(mask=mask) if mask == UPTIME_MASK:
                return Uptime((t_ns - self.boot_ns) // MS % (1 << 32))
            case c.GetFwVersion():
                return make_fw_version(config, self.uuid)
            case c.GetAppConf():
                timeout = motor.timeout_ms, motor.timeout_brake_current
                return AppConf(_SIGNATURE, config.controller_id, *timeout, _APPCONF_TAIL)
            case c.GetMcConfTemp():
                values: dict[str, Any] = {
                    f.name: getattr(motor.limits, f.name) for f in LIMIT_FIELDS
                }
                poles, gear, diameter = config.motor_poles, config.gear_ratio, config.wheel_diameter
                values |= {"motor_poles": poles, "gear_ratio": gear, "wheel_diameter": diameter}
                return McConfTemp(**values)
            case c.SetMcConfTemp():
                motor.limits = command
                return Ack(ids.CommandId.SET_MCCONF_TEMP) if command.ack else None
            case c.Reboot():
                self.reboot(t_ns)
        return None

    def _read_imu(self, mask: int, t_ns: int) -> telemetry.Imu:
        """GET_IMU_DATA reply: the latest 200 Hz sample; without a chip zeros and identity."""
        slot = t_ns // _IMU_PERIOD_NS
        if slot != self._imu_slot:
            self._imu_slot = slot
            self._imu = self._measure_imu() if self.config.imu else {"q_w": 1.0}
        return telemetry.Imu(mask, **self._imu, controller_id=self.config.controller_id)

    def _measure_imu(self) -> dict[str, float]:
        """Gyro and accelerometer of the car with noise, attitude from its yaw."""
        car, gyro, accel = self.car, self.config.gyro_noise, self.config.accel_noise
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

    def _reply(self, t_ns: int, reply: Reply) -> None:
        firmware, wrong = self.config.firmware, self.fault_state.wrong
        payload = encode_reply(reply, firmware)
        if wrong == "type":
            payload = bytes((payload[0] ^ 0x40,)) + payload[1:]
        elif wrong == "length":
            payload = payload[: max(1, len(payload) * 2 // 3)]
        elif wrong:  # an old firmware's layout, where that firmware has such a reply at all
            with suppress(ValueError):
                payload = encode_reply(reply, _OLDER if firmware > _OLDER else ids.FW_3_00)
        self._wire.send(t_ns, payload)

    def reported_erpm(self) -> float:
        """ERPM as reported."""
        faults = self.fault_state
        erpm = faults.erpm_sign * self._true_erpm()
        if self.car.speed:
            erpm += self.config.erpm_noise * self._noise.normal()
        if faults.erpm_stuck:
            self._stuck_erpm = int(erpm) if self._stuck_erpm is None else self._stuck_erpm
            return self._stuck_erpm
        return erpm
