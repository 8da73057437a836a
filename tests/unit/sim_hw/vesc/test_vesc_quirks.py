"""The list of `docs/reference/vesc-serial.md#v8`: one test per quirk, each named after it."""

import itertools
import math

import pytest

from steerd.car_model.state import ORIGIN
from steerd.sim_hw.vesc.vesc_motor import duty_current
from steerd.sim_hw.world import WorldConfig
from steerd.vesc_link import commands as c
from steerd.vesc_link import ids
from steerd.vesc_link.identity import Ack
from steerd.vesc_link.scaling import F1TENTH, servo_pos_to_steer
from steerd.vesc_link.telemetry import UPTIME_MASK, Values, has_chip

MS = 1_000_000
ROLLING = WorldConfig(start=ORIGIN._replace(speed=2.0))
ERPM_1 = 4614.0

host = pytest.fixture(lambda make_host: make_host())
rolling = pytest.fixture(lambda make_host: make_host(config=ROLLING))
old = pytest.fixture(lambda make_host: make_host(config=ROLLING, firmware=ids.FW_5_02))


def test_reply_comes_as_one_byte_then_the_rest(make_host):
    host = make_host(reply_delay_ns=300_000, fragment_gap_ns=50_000)
    host.send(c.GetFwVersion())
    assert host.world.serial_read(299_999) == b""
    assert host.world.serial_read(300_000) == b"\x02"
    assert host.world.serial_read(349_999) == b""
    assert len(host.world.serial_read(350_000)) > 30


def test_averages_restart_on_every_read_and_two_pollers_steal(host):
    host.hold(300, c.SetErpm(ERPM_1))
    host.values()
    host.hold(50, c.SetErpm(3 * ERPM_1))
    host.send(c.GetValues(), c.GetValues())
    host.run(1)
    first, second = host.heard()
    assert first.motor_current > 5.0
    assert second.motor_current == 0.0
    only_voltage = host.ask(c.GetValuesSelective(1 << 8))  # leaves the means of others alone
    assert only_voltage.motor_current is None


def test_timeout_with_brake_current_zero_coasts_and_a_timeout_of_zero_never_strikes(make_host):
    host = make_host(timeout_ms=150, timeout_brake_current=0.0)
    host.hold(1500, c.SetErpm(2 * ERPM_1))
    host.run(1160)
    assert host.speed == pytest.approx(2.0 - 0.6, abs=0.1)
    host = make_host(timeout_ms=0)
    host.send(c.SetErpm(2 * ERPM_1))
    host.run(5000)
    assert not host.values().status & 1
    assert host.speed == pytest.approx(2.0, abs=0.01)


def test_servo_commands_and_polls_do_not_feed_the_timeout_but_alive_does(host):
    host.send(c.SetErpm(ERPM_1))
    host.hold(300, c.SetServoPos(0.5), c.GetValues())
    assert host.world.vesc.motor.timed_out
    host.hold(500, c.SetErpm(ERPM_1))
    host.hold(500, c.Alive())
    assert not host.world.vesc.motor.timed_out
    assert host.speed == pytest.approx(1.0, abs=0.05)  # ALIVE keeps the last command running


def test_servo_does_nothing_when_its_output_is_disabled(make_host):
    host = make_host(servo_out=False)
    before = host.ask(c.GetValues()) and host.world.car.state.steer
    host.hold(500, c.SetServoPos(0.15))
    centre = servo_pos_to_steer(F1TENTH, 0.5)
    assert host.world.car.state.steer == pytest.approx(centre, abs=1e-3)
    assert abs(before - centre) < 0.03


def test_servo_samples_at_50_hz(make_host):
    host = make_host(servo_phase_ns=6 * MS)
    angles = []
    for k in range(20):  # a new angle every 5 ms
        host.send(c.SetServoPos(0.3 + 0.01 * k))
        host.run(5)
        angles.append(host.world.vesc._servo_out)
    changes = [k for k in range(1, 20) if angles[k] != angles[k - 1]]
    assert {b - a for a, b in itertools.pairwise(changes)} == {4}


def test_speed_ramp_is_25000_erpm_per_second_from_the_actual_speed_and_none_before_5_03(
    rolling, old
):
    for host, ms, ramped in ((rolling, 40, 2 * ERPM_1 + 1000), (old, 2, 5 * ERPM_1)):
        host.send(c.SetErpm(5 * ERPM_1))
        host.run(ms)
        assert host.world.vesc.motor.ramped == pytest.approx(ramped, abs=60 * (host is rolling))


def test_setpoints_below_900_erpm_coast(old):
    old.hold(500, c.SetErpm(899))
    assert old.speed == pytest.approx(2.0 - 0.5 * 0.6, abs=0.02)


def test_set_rpm_0_brakes_along_the_ramp_and_then_coasts(rolling):
    rolling.hold(1000, c.SetErpm(0))
    mode, _ = rolling.world.vesc.motor.step(rolling.t_ns, 0.002)
    assert mode.name == "RELEASED"
    assert 0.0 <= rolling.speed < 1.0


def test_invert_flag_turns_commands_telemetry_and_tachometer(make_host):
    host = make_host(invert=True)
    host.hold(1000, c.SetErpm(ERPM_1))
    assert host.speed == pytest.approx(-1.0, abs=0.02)
    values = host.values()
    assert values.erpm == pytest.approx(ERPM_1, abs=60)
    assert values.tachometer > 0


def test_current_pushes_both_ways_and_a_tiny_one_releases(host):
    host.hold(500, c.SetCurrent(-10.0))
    assert host.speed == pytest.approx(-0.5 * (10.0 * 0.175 - 0.6), rel=0.05)
    host.hold(20, c.SetCurrent(0.04))
    assert host.world.vesc.motor.value == 0.0


def test_duty_settles_where_back_emf_meets_the_battery(host):
    host.hold(4000, c.SetDuty(0.1))
    config = host.world.config.vesc
    erpm = host.world.vesc._true_erpm()
    drag = duty_current(config, 0.1, host.world.vesc.power.voltage, erpm)
    assert drag * config.accel_per_amp == pytest.approx(0.6, abs=0.05)
    assert host.values().duty == pytest.approx(0.1, abs=0.01)


def test_tachometer_counts_60_degree_steps_and_wraps_nothing_away(rolling):
    rolling.hold(1000, c.SetErpm(2 * ERPM_1))
    rolling.hold(1000, c.SetErpm(-2 * ERPM_1))
    rolling.hold(1500, c.SetErpm(-2 * ERPM_1))
    values, state = rolling.values(), rolling.world.car.state
    assert values.tachometer == pytest.approx(state.x * ERPM_1 / 10, abs=3)
    assert values.tachometer_abs > abs(values.tachometer)


def test_faults_clear_themselves_500_ms_after_their_condition(make_host):
    host = make_host(timeout_ms=0)
    host.hold(500, c.SetErpm(ERPM_1))
    host.world.vesc.motor.hold_fault(host.t_ns, 4)
    assert ids.fault_name(host.values().fault) == "ABS_OVER_CURRENT"
    host.hold(480, c.SetErpm(ERPM_1))
    assert host.values().fault == 4
    assert host.world.vesc.motor.mode.name == "RELEASED"  # commands are ignored
    host.run(30)
    assert host.values().fault == 0
    host.hold(500, c.SetErpm(ERPM_1))
    assert host.speed == pytest.approx(1.0, abs=0.02)  # the next command drives again


def test_voltage_sag_ends_in_under_voltage(make_host):
    host = make_host(battery_resistance=1.0, voltage_min=9.0)
    host.hold(400, c.SetErpm(4 * ERPM_1))
    assert ids.fault_name(host.values().fault) == "UNDER_VOLTAGE"


def test_uptime_counts_and_goes_back_with_a_reboot(make_host):
    host = make_host(uptime_ns=60_000 * MS)
    host.run(1000)
    assert host.ask(c.GetValuesSetupSelective(UPTIME_MASK)).uptime_ms == 61_000
    host.send(c.Reboot())
    with pytest.raises(OSError, match="Input/output"):
        host.world.serial_read(host.t_ns + MS)
    assert host.world.serial_name is None
    host.run(1600)
    assert host.world.serial_name == "vesc"
    assert host.ask(c.GetValuesSetupSelective(UPTIME_MASK)).uptime_ms <= 101


def test_limits_in_ram_are_acknowledged_read_back_and_enforced(host):
    limits = c.SetMcConfTemp(0.1, 1.0, -50e3, 1.5 * ERPM_1, 0.005, 0.95, -1500.0, 1500.0, -40, 40)
    assert isinstance(host.ask(limits), Ack)
    held = host.ask(c.GetMcConfTemp())
    assert held.erpm_max == pytest.approx(1.5 * ERPM_1)
    assert held.erpm_gain == pytest.approx(ERPM_1, rel=0.002)
    host.hold(2000, c.SetErpm(4 * ERPM_1))
    assert host.speed == pytest.approx(1.5, abs=0.01)
    host.send(c.SetCurrentBrake(60.0))
    assert host.world.vesc.motor.value == pytest.approx(6.0)


def test_imu_measures_the_car_and_repeats_its_200_hz_samples(make_host):
    host = make_host(gyro_noise=0.001, accel_noise=0.01)
    host.send(c.SetServoPos(0.3))
    host.hold(2000, c.SetErpm(2 * ERPM_1))
    one, two = host.ask(c.GetImuData(0xFFFF), 0.5), host.ask(c.GetImuData(0xFFFF), 0.5)
    assert one == two
    state = host.world.car.state
    assert one.gyro_z == pytest.approx(state.yaw_rate, abs=0.01)
    assert one.accel_y == pytest.approx(state.speed * state.yaw_rate, abs=0.1)
    assert has_chip(one.accel_x, one.accel_y, one.accel_z)
    attitude = 2.0 * math.atan2(one.q_z, one.q_w)
    assert math.remainder(attitude - state.yaw, math.tau) == pytest.approx(0.0, abs=0.05)


def test_host_that_does_not_read_blocks_the_vesc_and_gets_cut_frames(make_host):
    host = make_host(unread_limit=300, timeout_ms=0)
    for _ in range(4):
        host.send(c.GetValues())
    host.send(c.SetErpm(2000))
    assert host.world.vesc.motor.value == 0.0  # waits behind the blocked reply
    host.run(110)
    assert host.world.vesc.motor.value == 2000.0
    host.run(1)
    assert len([r for r in host.heard() if isinstance(r, Values)]) == 3
