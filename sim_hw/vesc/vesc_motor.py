"""A VESC's motor side: settings, what it makes of motor commands, what it measures of the battery.

Modes, speed ramp, timeout, faults, kill switch: the source of each behaviour is
`docs/reference/vesc-serial.md#v3`. Wire signs throughout: the motor's direction setting is applied
by `SimVesc`. Means since the last read are kept as running sums with a bookmark per telemetry
field, so reading one field does not touch the others; that is how the firmware's read-and-reset
behaves. Numbers without another source are engineering estimates of an F1TENTH car (3500 KV motor,
3S pack).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto

from steerd.sim_hw.plant.faults import HEALTHY_VESC, VescFaultState
from steerd.vesc_link import commands as c
from steerd.vesc_link.ids import FW_6_05, Firmware

MS = 1_000_000
STATUS_TIMEOUT, STATUS_KILL = 1, 2


@dataclass(frozen=True, slots=True)
class VescConfig:
    """Settings of one simulated VESC."""

    firmware: Firmware = FW_6_05  # its version; `steerd.vesc_link.ids.PROFILES` are the tested ones
    hw_name: str = "60_MK6"  # its identity (the UUID is the only one on USB)
    uuid: bytes = bytes.fromhex("35002b001350565020333831")
    controller_id: int = 107
    timeout_ms: int = 150  # motor timeout; 0 switches it off, the firmware's own default is 1000
    # What it applies then [A]; the firmware's own default 0 coasts
    timeout_brake_current: float = 20.0
    servo_out: bool = True  # whether the servo output exists (the firmware's own default is no)
    servo_frame_ns: int = 20 * MS  # period of the servo pulses (50 Hz); 0 passes angles on at once
    # First pulse of a run; 5 ms makes the mean wait of a synchronous 100 Hz loop exactly half a
    # frame
    servo_phase_ns: int = 5 * MS
    # The motor's direction setting; commands, ERPM and tachometer all follow it
    invert: bool = False
    # Ramp of the speed controller [ERPM/s] (s_pid_ramp_erpms_s, firmware 5.03)
    erpm_ramp: float = 25_000.0
    erpm_min: float = 900.0  # below this ramped setpoint the motor is released (s_pid_min_erpm)
    erpm_limit: float = 50_000.0  # configured limits
    current_limit: float = 60.0
    input_current_limit: float = 40.0
    watt_limit: float = 1_500.0
    duty_limit: float = 0.95
    # Acceleration per motor current [m/s^2/A]: ``60/(2 pi KV) * gear / (D/2) / mass`` = 0.0027 N
    # m/A * 11.8 / 0.049 m / 3.74 kg
    accel_per_amp: float = 0.175
    motor_kv: float = 3_500.0  # no-load rpm per volt
    motor_resistance: float = 0.03  # of a phase pair [Ohm]
    motor_poles: int = 4  # the drive train as set in VESC Tool
    gear_ratio: float = 11.8
    wheel_diameter: float = 0.0977
    battery_voltage: float = 11.8  # open-circuit voltage [V] and inner resistance [Ohm]
    battery_resistance: float = 0.02
    voltage_min: float = 8.0  # input voltage below which UNDER_VOLTAGE strikes [V]
    temp_limit_c: float = 100.0  # temperature above which OVER_TEMP_FET strikes
    imu: bool = True  # whether the board has an IMU chip (without, it answers zeros)
    gyro_noise: float = 0.005  # standard deviations [rad/s], [m/s^2]
    accel_noise: float = 0.05
    erpm_noise: float = 3.0  # standard deviation of the reported ERPM
    reply_delay_ns: int = 300_000  # from request to the first byte of the reply
    fragment_gap_ns: int = 50_000  # from a reply's first byte to the rest: USB sends it ahead alone
    # Bytes that wait for a host that does not read, before replies are cut
    unread_limit: int = 1024 + 4096
    reboot_ns: int = 1_500 * MS  # time without USB after a REBOOT
    uptime_ns: int = 60_000 * MS  # how long it had been running when the simulation starts


TICK_NS = 10 * MS  # period of the firmware's timeout thread
FAULT_STOP_NS = 500 * MS  # how long a fault outlasts its condition (m_fault_stop_time_ms)
_KILL_NS = 20 * MS
_CURRENT_MIN = 0.05  # below this the motor is released (cc_min_current) [A]
_RAMP_SINCE = Firmware(5, 3)
_NS = 1e9


class Mode(Enum):
    """What the motor controller is doing."""

    RELEASED = auto()
    SPEED = auto()
    CURRENT = auto()
    BRAKE = auto()
    DUTY = auto()


_SPEED = Mode.SPEED


class Motor:
    """The motor side of the firmware."""

    def __init__(self, config: VescConfig, t_ns: int) -> None:
        self.config = config
        self.fault_state: VescFaultState = HEALTHY_VESC  # what is wrong with it
        self.mode, self.value = Mode.RELEASED, 0.0  # command in force, as requested
        self.ramped = 0.0  # the speed controller's present setpoint [ERPM]
        self.timed_out = False  # the timeout has struck and no command has come since
        self.fault = 0  # fault code, 0 for none
        # Session limits in RAM (SET_MCCONF_TEMP), with those configured as their start
        self.limits = make_limits(config)
        self._ramps = config.firmware >= _RAMP_SINCE
        self._fed_ns = t_ns
        self._tick_ns = t_ns + TICK_NS
        self._fault_until_ns = self._ignore_until_ns = t_ns

    @property
    def timeout_ms(self) -> int:
        """The timeout in force; 0 for none."""
        given = self.fault_state.timeout_ms
        return self.config.timeout_ms if given is None else given

    @property
    def timeout_brake_current(self) -> float:
        """What the timeout applies [A]."""
        given = self.fault_state.timeout_brake_current
        return self.config.timeout_brake_current if given is None else given

    @property
    def status(self) -> int:
        """The status byte of firmware 5.03 and later."""
        struck = STATUS_TIMEOUT if self.timed_out or self.fault_state.timeout_bit else 0
        return struck | (STATUS_KILL if self.fault_state.kill else 0)

    def feed(self, t_ns: int) -> None:
        """Restart the timeout: any motor command does, even one that is then ignored."""
        self._fed_ns = t_ns

    def release(self) -> None:
        """Let the motor go."""
        self._set(Mode.RELEASED, 0.0)

    def hold_fault(self, t_ns: int, code: int) -> None:
        """A fault condition is there now: the motor is off until 500 ms after it last was."""
        self.fault = code
        self._fault_until_ns = t_ns + FAULT_STOP_NS
        self._set(Mode.RELEASED, 0.0)

    def command(self, t_ns: int, command: c.Command, erpm: float) -> None:
        """Obey a motor command at the present ``erpm``, unless something forbids it."""
        self.feed(t_ns)
        if self.fault_state.deaf or self.fault or t_ns < self._ignore_until_ns:
            return
        limit = self.config.current_limit
        match command:
            case c.SetErpm():
                if self.mode is not Mode.SPEED:
                    self.ramped = erpm
                low, high = self.limits.erpm_min, self.limits.erpm_max
                self._set(Mode.SPEED, min(max(command.erpm, low), high))
            case c.SetCurrentBrake():
                low = self.limits.current_min_scale * limit
                self._set(Mode.BRAKE, min(abs(command.current), low))
            case c.SetCurrent():
                self._set_current(command.current)
            case c.SetDuty():
                most = self.limits.duty_max
                self._set(Mode.DUTY, min(max(command.duty, -most), most))

    def _set_current(self, current: float) -> None:
        limit = self.config.current_limit
        low, high = self.limits.current_min_scale, self.limits.current_max_scale
        current = min(max(current, -low * limit), high * limit)
        small = abs(current) < _CURRENT_MIN
        self._set(Mode.RELEASED if small else Mode.CURRENT, 0.0 if small else current)

    def _set(self, mode: Mode, value: float) -> None:
        self.mode, self.value = mode, value

    def step(self, t_ns: int, h: float) -> tuple[Mode, float]:
        """Live through a physics step of ``h`` seconds from ``t_ns``.

        Returns:
            What the motor does, and its value: ERPM, A or a duty cycle.
        """
        if t_ns >= self._tick_ns:
            self._tick(t_ns)
        if self.fault and t_ns >= self._fault_until_ns:
            self.fault = 0
        if self.mode is not _SPEED:
            return self.mode, self.value
        # The ramp moves; a setpoint that is too slow releases the motor.
        if self._ramps:
            most = self.config.erpm_ramp * h
            gap = self.value - self.ramped
            self.ramped += most if gap > most else -most if gap < -most else gap
        else:
            self.ramped = self.value
        if -self.config.erpm_min < self.ramped < self.config.erpm_min:
            return Mode.RELEASED, 0.0
        return _SPEED, self.ramped

    def _tick(self, t_ns: int) -> None:
        """The 10 ms thread."""
        self._tick_ns += TICK_NS * ((t_ns - self._tick_ns) // TICK_NS + 1)
        timeout_ns = self.timeout_ms * MS
        if not timeout_ns or t_ns - self._fed_ns <= timeout_ns:
            self.timed_out = False
        elif not self.fault_state.deaf:
            if not self.timed_out:
                self.timed_out = True
                self._set(Mode.RELEASED, 0.0)
            if not self.fault:
                current = self.timeout_brake_current
                self._set(Mode.BRAKE if current > 0.0 else Mode.RELEASED, current)
        if self.fault_state.kill:
            self._set(Mode.RELEASED, 0.0)
            self._ignore_until_ns = max(self._ignore_until_ns, t_ns + _KILL_NS)


def make_limits(config: VescConfig) -> c.Limits:
    """Session limits at their start: the configured ones."""
    erpm, watt, current = config.erpm_limit, config.watt_limit, config.input_current_limit
    shares, duty = (1.0, 1.0), (0.005, config.duty_limit)
    return c.Limits(*shares, -erpm, erpm, *duty, -watt, watt, -current, current)


def duty_current(config: VescConfig, duty: float, voltage: float, erpm: float) -> float:
    """Motor current that a duty cycle drives against the back-EMF [A], within the limit."""
    emf = 2.0 * erpm / config.motor_poles / config.motor_kv
    current = (duty * voltage - emf) / config.motor_resistance
    return math.copysign(min(abs(current), config.current_limit), current)


_AMBIENT_C = 25.0
_HEATING = 2e-4
"""Warming per squared motor current [K/s/A^2]; with `_COOLING`, 30 A settle at +22 K."""
_COOLING = 120.0  # thermal time constant [s]
_FIELD_VOLTAGE = 3**-0.5  # phase voltage per bus voltage at full duty (space-vector modulation)
_FLAT = 0.1  # voltage below which no battery goes here, so that nothing divides by zero [V]
MEANS = {
    "motor_current": 2,
    "input_current": 3,
    "d_current": 4,
    "q_current": 5,
    "v_d": 19,
    "v_q": 20,
}
"""What is a mean since it was last read, and its bit in the mask of GET_VALUES_SELECTIVE."""


class Power:
    """Currents, voltages, temperature and tachometer of the simulated VESC."""

    def __init__(self, config: VescConfig) -> None:
        self.config = config
        self.duty = 0.0  # duty cycle
        self.voltage = config.battery_voltage  # battery voltage under load [V]
        self.revolutions = self.travel = 0.0  # electrical revolutions, signed and unsigned
        self.warmth = 0.0  # above ambient by the motor's own current [K]
        self.heat(0.0)
        self._motor_sum = self._input_sum = self._q_sum = self._vq_sum = 0.0
        self._count = 0
        self._read: dict[str, tuple[float, int]] = dict.fromkeys(MEANS, (0.0, 0))

    def heat(self, heat_c: float) -> None:
        """A fault heats it by so much."""
        self.heat_c = heat_c  # above ambient by a fault [K]
        # Of switches and motor
        self.temp_c = _AMBIENT_C + self.warmth + heat_c

    def step(self, current: float, erpm: float, h: float, sag: float) -> None:
        """Account for ``h`` seconds at a motor current [A] and ERPM, on a battery ``sag`` V low."""
        config = self.config
        emf = 2.0 * erpm / config.motor_poles / config.motor_kv
        duty = (emf + current * config.motor_resistance) / self.voltage
        limit = config.duty_limit
        self.duty = duty = -limit if duty < -limit else limit if duty > limit else duty
        source = duty * current
        loss = sag + config.battery_resistance * source
        voltage = config.battery_voltage - loss
        self.voltage = voltage if voltage > _FLAT else _FLAT
        revolutions = erpm * h / 60.0
        self.revolutions += revolutions
        self.travel += revolutions if revolutions > 0.0 else -revolutions
        self.warmth += h * (_HEATING * current * current - self.warmth / _COOLING)
        self.temp_c = _AMBIENT_C + self.warmth + self.heat_c
        strength = current if current > 0.0 else -current
        self._motor_sum += strength if source >= 0.0 else -strength
        self._input_sum += source
        self._q_sum += current
        self._vq_sum += duty * self.voltage
        self._count += 1

    def read_means(self, names: Iterable[str]) -> dict[str, float]:
        """Means of fields since the last read of each, which this is; 0 when read twice at once."""
        sums = {
            "motor_current": self._motor_sum, "input_current": self._input_sum,
            "q_current": self._q_sum, "v_q": self._vq_sum,
            "d_current": 0.0, "v_d": 0.0,  # the field-weakening axis
        }  # fmt: skip
        means = {}
        for name in names:
            (total, count), now = self._read[name], sums[name]
            samples = self._count - count
            mean = (now - total) / samples if samples else 0.0
            means[name] = mean * _FIELD_VOLTAGE if name == "v_q" else mean
            self._read[name] = (now, self._count)
        return means

    @property
    def tachometer(self) -> int:
        """Steps of 60 electrical degrees, signed, as the firmware's 32-bit counter."""
        steps = int(self.revolutions * 6.0)
        return (steps + (1 << 31)) % (1 << 32) - (1 << 31)

    @property
    def tachometer_abs(self) -> int:
        """Steps of 60 electrical degrees in both directions."""
        return int(self.travel * 6.0) % (1 << 31)
