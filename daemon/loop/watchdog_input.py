"""Gathers what the watchdogs look at in one tick."""

from math import nan

from steerd.controller.lane_controller import ControlReport
from steerd.daemon.loop.findings import Finding
from steerd.daemon.loop.following import Followed
from steerd.daemon.loop.loop_setup import LoopSetup
from steerd.daemon.loop.perception import Perception, estimated_state
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput
from steerd.estimator.state_filter import StateEstimate


def make_watchdog_input(
    setup: LoopSetup,
    seen: Perception,
    estimate: StateEstimate | None,
    report: ControlReport | None,
    *,
    state: SupervisorState,
    t_ns: int,
    lease_age: float,
    speed: float,
    speed_limit: float,
    steer: float,
    followed: Followed,
    reported: tuple[Finding, ...],
) -> WatchdogInput:
    """The measurements of a tick, NaN where nothing is known.

    Args:
        setup: of the loop.
        seen: poses and telemetry.
        estimate: of the car's state.
        report: of the lane keeper.
        state: the supervisor's, of the last tick.
        t_ns: now.
        lease_age: since lease and deadman were renewed, the older one [s].
        speed: best known [m/s].
        speed_limit: of the car now [m/s].
        steer: angle that was ordered last [rad].
        followed: measured motion against the orders.
        reported: findings from elsewhere.
    """
    settings = setup.settings
    s, health = estimated_state(estimate), estimate.health if estimate else None
    limits = settings.limits
    side = limits.steer_left_max if steer > 0.0 else limits.steer_right_max
    lane = None if setup.ignores_lane else report
    vesc = seen.values
    brakes = settings.brakes
    return WatchdogInput(
        t_ns=t_ns,
        state=state,
        pose=seen.watch,
        mocap_age=seen.mocap_age(t_ns),
        telemetry_age=seen.telemetry_age(t_ns),
        lease_age=lease_age,
        speed=speed,
        speed_erpm=seen.wheel_speed,
        speed_mocap=seen.mocap_speed,
        speed_limit=speed_limit,
        x=s.x,
        y=s.y,
        course=s.yaw + s.slip_angle,
        sigma_position=health.position_sd if health else nan,
        sigma_yaw=health.yaw_sd if health else nan,
        covariance_ok=health.sound if health else True,  # its sigmas are not known: W6 trips
        lateral_error=lane.e1 if lane else (0.0 if setup.ignores_lane else nan),
        heading_error=lane.e2 if lane else (0.0 if setup.ignores_lane else nan),
        steer_share=abs(steer) / side,
        status=vesc.status or 0,
        fault_code=vesc.fault or 0,
        tachometer=-1 if vesc.tachometer_abs is None else vesc.tachometer_abs,
        cell_voltage=_nan_if_none(vesc.input_voltage) / brakes.cells,
        fet_temperature=_nan_if_none(vesc.temp_fet_c),
        motor_temperature=_nan_if_none(vesc.temp_motor_c),
        current_share=abs(_nan_if_none(vesc.motor_current)) / brakes.current_max_a,
        followed=followed,
        reported=reported,
    )


def _nan_if_none(value: float | None) -> float:
    return nan if value is None else value
