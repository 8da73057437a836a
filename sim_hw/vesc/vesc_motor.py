"""What a VESC makes of motor commands: modes, speed ramp, timeout, faults, kill switch.

Source of each behaviour: `docs/reference/vesc-serial.md#v3`. Wire signs throughout: the motor's
direction setting is applied by `SimVesc`.
"""

import math
from enum import Enum, auto

from steerd.sim_hw.plant.fault_state import HEALTHY_VESC, VescFaultState
from steerd.sim_hw.vesc.vesc_config import MS, STATUS_KILL, STATUS_TIMEOUT, VescConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link.ids import Firmware

TICK_NS = 10 * MS
"""Period of the firmware's timeout thread."""
FAULT_STOP_NS = 500 * MS
"""How long a fault outlasts its condition (m_fault_stop_time_ms)."""
_KILL_NS = 20 * MS
_CURRENT_MIN = 0.05
"""Below this the motor is released (cc_min_current) [A]."""
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
    """The motor side of the firmware.

    Attributes:
        mode, value: command in force, as requested.
        ramped: the speed controller's present setpoint [ERPM].
        timed_out: the timeout has struck and no command has come since.
        fault: fault code, 0 for none.
        limits: session limits in RAM (SET_MCCONF_TEMP), with those configured as their start.
        fault_state: what is wrong with it.
    """

    def __init__(self, config: VescConfig, t_ns: int) -> None:
        self.config = config
        self.fault_state: VescFaultState = HEALTHY_VESC
        self.mode = Mode.RELEASED
        self.value = self.ramped = 0.0
        self.timed_out = False
        self.fault = 0
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

    def set_limits(self, command: c.SetMcConfTemp) -> None:
        """Take the session's limits (SET_MCCONF_TEMP)."""
        self.limits = {name: getattr(command, name) for name in self.limits}

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
                low, high = self.limits["erpm_min"], self.limits["erpm_max"]
                self._set(Mode.SPEED, min(max(command.erpm, low), high))
            case c.SetCurrentBrake():
                low = self.limits["current_min_scale"] * limit
                self._set(Mode.BRAKE, min(abs(command.current), low))
            case c.SetCurrent():
                self._set_current(command.current)
            case c.SetDuty():
                most = self.limits["duty_max"]
                self._set(Mode.DUTY, min(max(command.duty, -most), most))

    def _set_current(self, current: float) -> None:
        limit = self.config.current_limit
        low, high = self.limits["current_min_scale"], self.limits["current_max_scale"]
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


def make_limits(config: VescConfig) -> dict[str, float]:
    """Session limits at their start: the configured ones."""
    return {
        "current_min_scale": 1.0,
        "current_max_scale": 1.0,
        "erpm_min": -config.erpm_limit,
        "erpm_max": config.erpm_limit,
        "duty_min": 0.005,
        "duty_max": config.duty_limit,
        "watt_min": -config.watt_limit,
        "watt_max": config.watt_limit,
        "input_current_min": -config.input_current_limit,
        "input_current_max": config.input_current_limit,
    }


def duty_current(config: VescConfig, duty: float, voltage: float, erpm: float) -> float:
    """Motor current that a duty cycle drives against the back-EMF [A], within the limit."""
    emf = 2.0 * erpm / config.motor_poles / config.motor_kv
    current = (duty * voltage - emf) / config.motor_resistance
    return math.copysign(min(abs(current), config.current_limit), current)
