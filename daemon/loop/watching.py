"""What is watched in a tick: the watchdogs' measurements, and findings that are not by thresholds.

`watchdogs` judges measurements; here they are taken, with the memories that go from tick to tick:
lateness of the loop, the launch window, and the orders that wheels and pose are held against.
"""

from math import isfinite, nan

from steerd.car_model.actuators import references
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import Car
from steerd.car_model.state import Command, State
from steerd.controller.lane_controller import ControlReport
from steerd.controller.limits import Verdict
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.loop import findings as fs
from steerd.daemon.loop import following
from steerd.daemon.loop.follow_model import make_follow_model
from steerd.daemon.loop.lateness import IN_SIMULATION, Lateness, make_lateness_rules, step_lateness
from steerd.daemon.loop.launch import LaunchInput, LaunchState, make_launch_state, step_launch
from steerd.daemon.loop.lease import Remote, lease_age, valid_command
from steerd.daemon.loop.orders import Order
from steerd.daemon.loop.perception import Perception, estimated_state
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput, WatchdogState, is_slowing, step_watchdogs
from steerd.daemon.settings.thresholds import LAUNCH_SPEED
from steerd.estimator.state_filter import StateEstimate
from steerd.steer_bus.quick_values import quick_value


@quick_value
class TickInput:
    """What is judged in a tick, but for the measurements."""

    due_ns: int  # when it was due
    t_ns: int  # now
    flags: int  # of the runner
    state: SupervisorState  # the supervisor's, of the last tick
    order: Command[float]  # the last one
    estimate: StateEstimate | None  # of the car's state
    lane: ControlReport | None  # errors of its place in the lane; None where they are not known
    remote: Remote  # the external controller
    speed: float  # best known [m/s]
    silent: float  # time since the operator's last request [s]


class Watching:
    """Watchdogs and their memories.

    Attributes:
        launched: whether the launch checks of this drive have passed.
        slowing: whether a stop works, by the check of W24.
    """

    def __init__(self, plan: RunPlan, car: Car[float], perception: Perception) -> None:
        s = plan.settings
        self._plan, self._settings, self._car, self._seen = plan, s, car, perception
        self._launch: LaunchState | None = None
        self.launched, self.slowing = False, True
        self._watchdogs = WatchdogState()
        self._ranges = make_follow_model(car, s.file.sd, s.filter, s.thresholds)
        self._following = following.FollowState()
        self._lateness = Lateness()
        self._not_finite = False
        simulated = plan.options.simulated
        self._late_rules = IN_SIMULATION if simulated else make_lateness_rules(s.thresholds)

    def restart_launch(self) -> None:
        """A drive begins or has ended: the next one is launched anew."""
        self._launch, self.launched = None, False

    def send_order(self, t_ns: int, order: Order) -> None:
        """An order leaves now."""
        self._not_finite = order.verdict is Verdict.NOT_FINITE
        rolling = self._seen.wheel_speed
        speed = rolling if isfinite(rolling) else 0.0
        self._following = following.send_order(
            self._following, self._ranges, t_ns, order.command, speed
        )

    def look(self, tick: TickInput) -> tuple[WatchdogInput, tuple[fs.Finding, ...]]:
        """The measurements of a tick, NaN where nothing is known, and all findings."""
        now_ns, state, estimate, lane = tick.t_ns, tick.state, tick.estimate, tick.lane
        reported = [*fs.make_reported_findings(tick.flags), *self._find_late(tick)]
        running = state is SupervisorState.RUNNING
        if running and estimate is not None and not self.launched:
            reported += self._check_launch(estimate.state, tick.order, now_ns)
        if self._not_finite:
            what = "the controller gave a number that is not finite"
            reported.append(fs.make_finding("limiter", what))
        if running and self._plan.remote:
            reported += _find_silence(tick.remote, now_ns)
        seen, limits, brakes = self._seen, self._settings.limits, self._settings.brakes
        s, health = estimated_state(estimate), estimate.health if estimate else None
        v, (e1, e2) = seen.values, (lane.e1, lane.e2) if lane else (nan, nan)
        steer = tick.order.steer
        if self._plan.ignores_lane:
            e1 = e2 = 0.0
        now = WatchdogInput(
            t_ns=now_ns,
            state=state,
            pose=seen.watch,
            mocap_age=seen.mocap_age(now_ns),
            telemetry_age=seen.telemetry_age(now_ns),
            lease_age=tick.silent,
            speed=tick.speed,
            speed_erpm=seen.wheel_speed,
            speed_mocap=seen.mocap_speed,
            speed_limit=limits.speed_max if self.launched else min(LAUNCH_SPEED, limits.speed_max),
            x=s.x,
            y=s.y,
            course=s.yaw + s.slip_angle,
            sigma_position=health.position_sd if health else nan,
            sigma_yaw=health.yaw_sd if health else nan,
            covariance_ok=health.sound if health else True,  # its sigmas are not known: W6 trips
            lateral_error=e1,
            heading_error=e2,
            steer_share=abs(steer)
            / (limits.steer_left_max if steer > 0.0 else limits.steer_right_max),
            status=v.status if v.status > 0 else 0,  # -1: not sent
            fault_code=v.fault_code if v.fault_code > 0 else 0,
            tachometer=v.tachometer_abs,
            cell_voltage=v.v_in / brakes.cells,
            fet_temperature=v.temp_fet,
            motor_temperature=v.temp_motor,
            current_share=abs(v.current_motor) / brakes.current_max_a,
            followed=self._compare_with_orders(now_ns),
            reported=tuple(reported),
        )
        self._watchdogs, found = step_watchdogs(self._settings.thresholds, self._watchdogs, now)
        self.slowing = is_slowing(self._watchdogs)
        advised = found and self._plan.options.simulated
        return now, tuple(map(fs.advise_simulation, found)) if advised else found

    def _find_late(self, tick: TickInput) -> list[fs.Finding]:
        """W15."""
        self._lateness, late = step_lateness(
            self._lateness, tick.due_ns, tick.t_ns, self._plan.period_ns, self._late_rules
        )
        return [] if late is None else [fs.blame_late(late, tick.flags)]

    def _check_launch(self, s: State[float], order: Command[float], t_ns: int) -> list[fs.Finding]:
        aim = references(FLOAT, self._car, order)  # gain and bias of the linkage
        now = LaunchInput(t_ns, s.x, s.y, s.yaw, self._seen.wheel_speed, aim.steer)
        if self._launch is None:
            self._launch = make_launch_state(now)
            return []
        self._launch, wrong = step_launch(self._launch, now, self._settings.limits.wheelbase)
        self.launched = self._launch.done
        return [fs.make_finding("launch", wrong)] if wrong else []

    def _compare_with_orders(self, now_ns: int) -> following.Followed:
        """What wheels and pose did since, against the orders that left."""
        seen = self._seen
        ground = seen.mocap_speed if isfinite(seen.mocap_speed) else 0.0
        self._following = following.advance(self._following, self._ranges, now_ns, ground)
        turns = following.measure_turns(
            seen.track, following.follow_span(self._settings.thresholds, ground)
        )
        return following.compare(self._following, self._ranges, seen.wheel, turns)


def _find_silence(remote: Remote, now_ns: int) -> list[fs.Finding]:
    """W25 of an external controller."""
    if valid_command(remote, now_ns) is not None:
        return []
    age = lease_age(remote.lease, now_ns)
    if not isfinite(age):
        return [fs.make_unknown("W25", "no valid command yet")]
    return [fs.make_finding("W25", f"no valid command for {age * 1e3:.0f} ms")]
