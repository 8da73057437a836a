"""How the simulated VESC is built and set: firmware, drive train, battery, app settings, timing.

Numbers without another source are engineering estimates of an F1TENTH car (3500 KV motor, 3S pack).
"""

from dataclasses import dataclass

from steerd.vesc_link.ids import FW_6_05, Firmware

MS = 1_000_000
STATUS_TIMEOUT, STATUS_KILL = 1, 2


@dataclass(frozen=True, slots=True)
class VescConfig:
    """Settings of one simulated VESC.

    Attributes:
        firmware: its version; `steerd.vesc_link.ids.PROFILES` are the tested ones.
        hw_name, uuid, controller_id: its identity (the UUID is the only one on USB).
        timeout_ms: motor timeout; 0 switches it off, the firmware's own default is 1000.
        timeout_brake_current: what it applies then [A]; the firmware's own default 0 coasts.
        servo_out: whether the servo output exists (the firmware's own default is no).
        servo_frame_ns: period of the servo pulses (50 Hz); 0 passes angles on at once.
        servo_phase_ns: first pulse of a run; 5 ms makes the mean wait of a synchronous 100 Hz
            loop exactly half a frame.
        invert: the motor's direction setting; commands, ERPM and tachometer all follow it.
        erpm_ramp: ramp of the speed controller [ERPM/s] (s_pid_ramp_erpms_s, firmware 5.03).
        erpm_min: below this ramped setpoint the motor is released (s_pid_min_erpm).
        erpm_limit, current_limit, input_current_limit, watt_limit, duty_limit: configured limits.
        accel_per_amp: acceleration per motor current [m/s^2/A]:
            ``60/(2 pi KV) * gear / (D/2) / mass`` = 0.0027 N m/A * 11.8 / 0.049 m / 3.74 kg.
        motor_kv: no-load rpm per volt.
        motor_resistance: of a phase pair [Ohm].
        motor_poles, gear_ratio, wheel_diameter: the drive train as set in VESC Tool.
        battery_voltage, battery_resistance: open-circuit voltage [V] and inner resistance [Ohm].
        voltage_min: input voltage below which UNDER_VOLTAGE strikes [V].
        temp_limit_c: temperature above which OVER_TEMP_FET strikes.
        imu: whether the board has an IMU chip (without, it answers zeros).
        gyro_noise, accel_noise: standard deviations [rad/s], [m/s^2].
        erpm_noise: standard deviation of the reported ERPM.
        reply_delay_ns: from request to the first byte of the reply.
        fragment_gap_ns: from a reply's first byte to the rest: USB sends it ahead alone.
        unread_limit: bytes that wait for a host that does not read, before replies are cut.
        reboot_ns: time without USB after a REBOOT.
        uptime_ns: how long it had been running when the simulation starts.
        boot_garbage: bytes of noise that it sends when it comes up.
    """

    firmware: Firmware = FW_6_05
    hw_name: str = "60_MK6"
    uuid: bytes = bytes.fromhex("35002b001350565020333831")
    controller_id: int = 107
    timeout_ms: int = 150
    timeout_brake_current: float = 20.0
    servo_out: bool = True
    servo_frame_ns: int = 20 * MS
    servo_phase_ns: int = 5 * MS
    invert: bool = False
    erpm_ramp: float = 25_000.0
    erpm_min: float = 900.0
    erpm_limit: float = 50_000.0
    current_limit: float = 60.0
    input_current_limit: float = 40.0
    watt_limit: float = 1_500.0
    duty_limit: float = 0.95
    accel_per_amp: float = 0.175
    motor_kv: float = 3_500.0
    motor_resistance: float = 0.03
    motor_poles: int = 4
    gear_ratio: float = 11.8
    wheel_diameter: float = 0.0977
    battery_voltage: float = 11.8
    battery_resistance: float = 0.02
    voltage_min: float = 8.0
    temp_limit_c: float = 100.0
    imu: bool = True
    gyro_noise: float = 0.005
    accel_noise: float = 0.05
    erpm_noise: float = 3.0
    reply_delay_ns: int = 300_000
    fragment_gap_ns: int = 50_000
    unread_limit: int = 1024 + 4096
    reboot_ns: int = 1_500 * MS
    uptime_ns: int = 60_000 * MS
    boot_garbage: int = 0

    @property
    def servo_wait(self) -> float:
        """Mean wait of an angle for the next servo pulse [s]."""
        return self.servo_frame_ns / 2e9
