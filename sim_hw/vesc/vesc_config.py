"""How the simulated VESC is built and set: firmware, drive train, battery, app settings, timing.

Numbers without another source are engineering estimates of an F1TENTH car (3500 KV motor, 3S pack).
"""

from dataclasses import dataclass

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
    boot_garbage: int = 0  # bytes of noise that it sends when it comes up

    @property
    def servo_wait(self) -> float:
        """Mean wait of an angle for the next servo pulse [s]."""
        return self.servo_frame_ns / 2e9
