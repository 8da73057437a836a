"""What a VESC measures of its motor and battery, from what the wheels do.

Means since the last read are kept as running sums with a bookmark per telemetry field, so reading
one field does not touch the others; that is how the firmware's read-and-reset behaves.
"""

from collections.abc import Iterable

from steerd.sim_hw.vesc.vesc_config import VescConfig

_AMBIENT_C = 25.0
_HEATING = 2e-4
"""Warming per squared motor current [K/s/A^2]; with `_COOLING`, 30 A settle at +22 K."""
_COOLING = 120.0
"""Thermal time constant [s]."""
_FIELD_VOLTAGE = 3**-0.5
"""Phase voltage per bus voltage at full duty (space-vector modulation)."""
_FLAT = 0.1
"""Voltage below which no battery goes here, so that nothing divides by zero [V]."""
MEANS = ("motor_current", "input_current", "d_current", "q_current", "v_d", "v_q")


class Power:
    """Currents, voltages, temperature and tachometer of the simulated VESC.

    Attributes:
        current: motor current, positive drives forward on the wire [A].
        voltage: battery voltage under load [V].
        duty: duty cycle.
        revolutions, travel: electrical revolutions, signed and unsigned.
        temp_c: of switches and motor.
        warmth, heat_c: above ambient by the motor's own current, and by a fault [K].
    """

    def __init__(self, config: VescConfig) -> None:
        self.config = config
        self.current = self.duty = 0.0
        self.voltage = config.battery_voltage
        self.revolutions = self.travel = 0.0
        self.warmth = 0.0
        self.heat(0.0)
        self.input_current = 0.0
        self._motor_sum = self._input_sum = self._q_sum = self._vq_sum = 0.0
        self._count = 0
        self._read: dict[str, tuple[float, int]] = dict.fromkeys(MEANS, (0.0, 0))

    def heat(self, heat_c: float) -> None:
        """A fault heats it by so much."""
        self.heat_c = heat_c
        self.temp_c = _AMBIENT_C + self.warmth + heat_c

    def step(self, current: float, erpm: float, h: float, sag: float) -> None:
        """Account for ``h`` seconds at a motor current [A] and ERPM, on a battery ``sag`` V low."""
        config = self.config
        emf = 2.0 * erpm / config.motor_poles / config.motor_kv
        self.current = current
        duty = (emf + current * config.motor_resistance) / self.voltage
        limit = config.duty_limit
        self.duty = duty = -limit if duty < -limit else limit if duty > limit else duty
        source = self.input_current = duty * current
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
