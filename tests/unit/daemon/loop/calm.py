"""Measurements of calm driving, in which no watchdog has a finding."""

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput
from steerd.daemon.loop.watchdogs_pose import PoseWatch

CALM = WatchdogInput(
    t_ns=10**9, state=SupervisorState.RUNNING, pose=PoseWatch(), mocap_age=0.0, telemetry_age=0.0,
    lease_age=0.0, speed=1.5, speed_erpm=1.5, speed_mocap=1.5, speed_limit=2.0, x=0.0, y=0.0,
    course=0.0, sigma_position=0.01, sigma_yaw=0.01, covariance_ok=True, lateral_error=0.0,
    heading_error=0.0, steer_share=0.0, status=0, fault_code=0, tachometer=-1, cell_voltage=3.9,
    fet_temperature=40.0, motor_temperature=40.0, current_share=0.1,
)  # fmt: skip
