"""The loop: events in, orders out. No clock, no I/O, no randomness.

The real-time runner, virtual time and replay drive the same loop: the same events in the same order
give the same orders. Decisions are made by the pure functions that it calls; the loop keeps their
states from tick to tick.
"""

from collections.abc import Iterator
from math import isfinite, nan

from steerd.car_model.actuators import references
from steerd.car_model.nominal_car import believed_car
from steerd.car_model.ops import FLOAT
from steerd.car_model.state import Command
from steerd.controller.lane_controller import ControllerState, ControlReport, start_controller
from steerd.controller.limits import Verdict, make_limiter_state
from steerd.controller.live import AS_DESIGNED
from steerd.daemon.loop.adapting import (
    lose_estimate,
    make_adapting,
    remember_order,
    steer,
    take_design,
)
from steerd.daemon.loop.checks import (
    STANDING_SPEED,
    VescInfo,
    check_controller,
    check_findings,
    check_flags,
    check_lane,
    check_motion,
    check_vesc,
)
from steerd.daemon.loop.design_desk import read_design
from steerd.daemon.loop.findings import (
    Finding,
    advise_simulation,
    make_finding,
    make_unknown,
    summarise,
)
from steerd.daemon.loop.flags import Flag, blame_late, make_reported_findings
from steerd.daemon.loop.follow_model import make_follow_model
from steerd.daemon.loop.following import (
    Followed,
    FollowState,
    advance,
    compare,
    follow_span,
    measure_turns,
    send_order,
)
from steerd.daemon.loop.lateness import IN_SIMULATION, Lateness, make_lateness_rules, step_lateness
from steerd.daemon.loop.launch import LaunchInput, LaunchState, make_launch_state, step_launch
from steerd.daemon.loop.lease import (
    Lease,
    Remote,
    accept_request,
    admit,
    command_age,
    lease_age,
    take_command,
    valid_command,
)
from steerd.daemon.loop.live import judge_both_lanes, make_live, relax, step_live, take_request
from steerd.daemon.loop.loop_setup import LoopSetup
from steerd.daemon.loop.orders import Order, make_order
from steerd.daemon.loop.perception import Perception, best_speed, estimated_state
from steerd.daemon.loop.plans import Drill
from steerd.daemon.loop.supervisor import (
    Action,
    Conditions,
    SupervisorMemory,
    make_supervisor_memory,
    stands,
    step_supervisor,
)
from steerd.daemon.loop.transitions import Fact, Request, SupervisorState, is_engaged
from steerd.daemon.loop.watchdogs import WatchdogInput, WatchdogState, is_slowing, step_watchdogs
from steerd.daemon.settings.thresholds import LAUNCH_SPEED
from steerd.estimator.state_filter import StateEstimate
from steerd.steer_bus.messages import Design, DriveCommand, OperatorRequest, ParameterRequest
from steerd.steer_bus.quick_values import quick_value

_DRIVING = (SupervisorState.RUNNING, SupervisorState.STOPPING)
_HARD = (SupervisorState.FAULT_STOP, SupervisorState.ESTOP)
_PARKED = (
    SupervisorState.INIT,
    SupervisorState.DISARMED,
    SupervisorState.READY,
    SupervisorState.FAULT_LATCHED,
)
_RELOCATE_TICKS = 25
"""A parked car may be carried: its place on the path is searched anew every so many ticks."""
_LEASE_KEPT_S = 1.0
"""Time for which a silent operator keeps the lease while the car is not parked [s]."""


@quick_value
class TickResult:
    """Decision of one tick and its inputs."""

    order: Order  # for the wire
    action: Action  # of the supervisor
    old: SupervisorState  # the supervisor's state before the tick
    supervisor: SupervisorMemory  # the supervisor after it
    estimate: StateEstimate | None  # of the car's state, None before the first
    report: ControlReport | None  # of the lane keeper, None without an estimate
    findings: tuple[Finding, ...]  # of the watchdogs
    waiting: str  # what the supervisor waits for, for people
    facts: int  # bits of `Fact`


class Loop:
    """The control loop's state.

    Attributes:
        setup: what does not change.
        perception: measurements, which are handed to it, and the state estimate.
        supervisor: memory of the state machine.
        lease, remote: the operator and the external controller.
        live: what may be changed while the car drives.
        adapting: which design steers.
        vesc: what the VESC reported about itself, or None.
        fault: why a watchdog, a fault stop or an emergency stop ended the last drive, or nothing.
        ran: a drive has ended in this run.
    """

    def __init__(self, setup: LoopSetup) -> None:
        s = setup.settings
        self.setup = setup
        car = self._car = believed_car(s.file.model)
        self.perception = Perception(car, s.file.chassis, s.filter, s.thresholds, s.scaling)
        self.supervisor = make_supervisor_memory(0)
        self.lease = Lease(setup.boot_id)
        self.remote = Remote()
        self.live = make_live(setup.live)
        self.adapting = make_adapting(setup.controller, setup.learnt, s.thresholds.lateral)
        self.vesc: VescInfo | None = None
        self.fault = ""
        self.ran = False
        self._limiter = make_limiter_state(s.limits, Command(0.0, 0.0), 0)
        self._issued: Command[float] | None = None
        self._control: ControllerState | None = None
        self._launch: LaunchState | None = None
        self._watchdogs = WatchdogState()
        self._ranges = make_follow_model(car, s.file.sd, s.filter, s.thresholds)
        self._following = FollowState()
        self._lateness = Lateness()
        self._late_rules = IN_SIMULATION if setup.simulated else make_lateness_rules(s.thresholds)
        self._requests_pending = 0
        self._not_finite = False
        self._started_ns = 0
        self._ticks = 0

    # --- events

    def on_vesc(self, vesc: VescInfo | None) -> None:
        """The VESC reported about itself, or is gone (None)."""
        self.vesc = vesc

    def on_operator(self, message: OperatorRequest, t_ns: int) -> None:
        """An operator's request arrived."""
        before = self.lease.holder
        self.lease, request = accept_request(self.lease, message, t_ns, self._is_idle(t_ns))
        self._requests_pending |= int(request)
        self._pass_on(before)

    def on_parameters(self, message: ParameterRequest, t_ns: int) -> None:
        """A request for other live parameters arrived."""
        before = self.lease.holder
        self.lease, admitted = admit(self.lease, message, t_ns, self._is_idle(t_ns))
        self._pass_on(before)
        self.live = take_request(self.live, message, admitted)

    def _is_idle(self, t_ns: int) -> bool:
        """Whether the operator has been silent for so long that another may take over."""
        parked = self.supervisor.state in _PARKED
        patience_s = self.setup.settings.thresholds.lease if parked else _LEASE_KEPT_S
        return lease_age(self.lease, t_ns) > patience_s

    def _pass_on(self, before: int) -> None:
        """An operator does not inherit what another tuned; without a deadman there is no holder."""
        if self.setup.leased and before not in (0, self.lease.holder):
            self.live = relax(self.live, "another operator: path and gains as designed")

    def on_drive(self, command: DriveCommand, t_ns: int) -> None:
        """An external controller's command arrived."""
        self.remote = take_command(self.remote, self.setup.boot_id, command, t_ns)

    def on_design(self, message: Design, t_ns: int) -> None:
        """A design was taken; who hands it over has checked it, or reads what was recorded."""
        design = read_design(message)
        self.adapting = take_design(self.adapting, message.number, design, message.text, t_ns)

    # --- the tick

    def tick(self, due_ns: int, now_ns: int, flags: int) -> TickResult:
        """Decide what goes on the wire now."""
        estimate = self.perception.estimate(now_ns)
        speed = best_speed(estimate, self.perception.recent_wheel_speed(now_ns))
        wish, report = self._make_wish(estimate, now_ns)
        reported = self._report(estimate, due_ns, now_ns, flags)
        now = self._measure(estimate, report, speed, now_ns, reported)
        findings = self._run_watchdogs(now)
        failed = self._find_failed_checks(now, findings, report is not None, flags)
        bits, text = summarise(findings)
        facts = bits | self._make_facts(now, estimate, failed, flags)
        conditions = Conditions(facts, speed, self._timeout_ns(), text)
        old = self.supervisor.state
        self.supervisor, action = step_supervisor(
            self.supervisor, conditions, self._merge_requests(flags), now_ns
        )
        self._requests_pending = 0
        self._apply_transition(old, estimate, now_ns, text)
        order = make_order(
            self.setup.settings.limits,
            self.setup.settings.brakes,
            self.setup.settings.scaling,
            self._limiter,
            action,
            wish,
            speed,
            now_ns,
        )
        self._remember_order(order, now_ns)
        waiting = (
            failed[0]
            if failed and self.supervisor.state is SupervisorState.DISARMED
            else action.waiting
        )
        return TickResult(
            order, action, old, self.supervisor, estimate, report, findings, waiting, facts
        )

    def _make_wish(
        self, estimate: StateEstimate | None, now_ns: int
    ) -> tuple[Command[float] | None, ControlReport | None]:
        """The controller's command and its report on the lane errors."""
        if estimate is None or not estimate.health.sound:
            self._control = None
            self.adapting = lose_estimate(self.adapting)
            return None, None
        self._ticks += 1
        self.live = step_live(self.live, now_ns, self.supervisor.state in _PARKED)
        lost = self.supervisor.state in _PARKED and self._ticks % _RELOCATE_TICKS == 0
        if self._control is None or lost:
            design = self.adapting.controller
            self._control = start_controller(design, estimate.state, now_ns)
        state = self.supervisor.state
        wish, report, self._control, self.adapting = steer(
            self.adapting,
            self._control,
            estimate.state,
            now_ns,
            issued=self._issued,
            driving=state in _DRIVING,
            stop=state is not SupervisorState.RUNNING,
            live=self.live.now if self.setup.live else AS_DESIGNED,
        )
        if self.setup.remote:
            return self._make_remote_wish(now_ns), report
        if self.setup.drill is not None:
            return self._apply_drill(self.setup.drill, wish, now_ns), report
        return wish, report

    def _apply_drill(self, drill: Drill, lane: Command[float], now_ns: int) -> Command[float]:
        """The excitation plan's command; outside the drive the steering angle stays."""
        if self.supervisor.state is SupervisorState.RUNNING:
            return drill.wish((now_ns - self._started_ns) * 1e-9, lane)
        return lane if drill.closed else Command(self._limiter.order.steer, lane.speed)

    def _make_remote_wish(self, now_ns: int) -> Command[float] | None:
        command = valid_command(self.remote, now_ns)
        if command is not None:
            return Command(command.steer, command.speed)
        # Lost while driving: hold the angle; the stop that follows takes the speed away.
        held = self._limiter.order
        return held if self.supervisor.state in _DRIVING else None

    def _report(
        self, estimate: StateEstimate | None, due_ns: int, now_ns: int, flags: int
    ) -> tuple[Finding, ...]:
        """What is found beside the watchdogs: by runner, lateness, launch and command check."""
        reported = list(make_reported_findings(flags))
        self._lateness, late = step_lateness(
            self._lateness, due_ns, now_ns, self.setup.period_ns, self._late_rules
        )
        if late is not None:
            reported.append(blame_late(late, flags))
        return (*reported, *self._check_launch(estimate, now_ns), *self._check_commands(now_ns))

    def _run_watchdogs(self, now: WatchdogInput) -> tuple[Finding, ...]:
        self._watchdogs, findings = step_watchdogs(
            self.setup.settings.thresholds, self._watchdogs, now
        )
        return tuple(map(advise_simulation, findings)) if self.setup.simulated else findings

    def _measure(
        self,
        estimate: StateEstimate | None,
        report: ControlReport | None,
        speed: float,
        now_ns: int,
        reported: tuple[Finding, ...],
    ) -> WatchdogInput:
        """The measurements of a tick, NaN where nothing is known."""
        seen, settings, ignores_lane = self.perception, self.setup.settings, self.setup.ignores_lane
        s, health = estimated_state(estimate), estimate.health if estimate else None
        lane = None if report is None or ignores_lane else judge_both_lanes(report, self.live.now)
        nowhere = 0.0 if ignores_lane else nan
        limits, brakes, steer = settings.limits, settings.brakes, self._limiter.order.steer
        launched = self._launch is not None and self._launch.done
        v = seen.values
        return WatchdogInput(
            t_ns=now_ns,
            state=self.supervisor.state,
            pose=seen.watch,
            mocap_age=seen.mocap_age(now_ns),
            telemetry_age=seen.telemetry_age(now_ns),
            lease_age=lease_age(self.lease, now_ns) if self.setup.leased else 0.0,
            speed=speed,
            speed_erpm=seen.wheel_speed,
            speed_mocap=seen.mocap_speed,
            speed_limit=limits.speed_max if launched else min(LAUNCH_SPEED, limits.speed_max),
            x=s.x,
            y=s.y,
            course=s.yaw + s.slip_angle,
            sigma_position=health.position_sd if health else nan,
            sigma_yaw=health.yaw_sd if health else nan,
            covariance_ok=health.sound if health else True,  # its sigmas are not known: W6 trips
            lateral_error=lane.e1 if lane else nowhere,
            heading_error=lane.e2 if lane else nowhere,
            steer_share=abs(steer)
            / (limits.steer_left_max if steer > 0.0 else limits.steer_right_max),
            status=v.status or 0,
            fault_code=v.fault or 0,
            tachometer=-1 if v.tachometer_abs is None else v.tachometer_abs,
            cell_voltage=nan if v.input_voltage is None else v.input_voltage / brakes.cells,
            fet_temperature=nan if v.temp_fet_c is None else v.temp_fet_c,
            motor_temperature=nan if v.temp_motor_c is None else v.temp_motor_c,
            current_share=nan
            if v.motor_current is None
            else abs(v.motor_current) / brakes.current_max_a,
            followed=self._compare_with_orders(now_ns),
            reported=reported,
        )

    def _compare_with_orders(self, now_ns: int) -> Followed:
        """What wheels and pose did since, against the orders that left."""
        seen = self.perception
        speed = seen.mocap_speed
        ground = speed if isfinite(speed) else 0.0
        self._following = advance(self._following, self._ranges, now_ns, ground)
        turns = measure_turns(seen.track, follow_span(self.setup.settings.thresholds, ground))
        return compare(self._following, self._ranges, seen.wheel, turns)

    def _check_launch(self, estimate: StateEstimate | None, now_ns: int) -> Iterator[Finding]:
        if self.supervisor.state is not SupervisorState.RUNNING or estimate is None:
            return
        if self._launch is not None and self._launch.done:
            return
        s = estimate.state
        wheel_speed = self.perception.wheel_speed
        aim = references(FLOAT, self._car, self._limiter.order)  # gain and bias of the linkage
        now = LaunchInput(now_ns, s.x, s.y, s.yaw, wheel_speed, aim.steer)
        if self._launch is None:
            self._launch = make_launch_state(now)
            return
        self._launch, wrong = step_launch(self._launch, now, self.setup.settings.limits.wheelbase)
        if wrong:
            yield make_finding("launch", wrong)

    def _check_commands(self, now_ns: int) -> Iterator[Finding]:
        if self._not_finite:
            yield make_finding("limiter", "the controller gave a number that is not finite")
        driving = self.supervisor.state is SupervisorState.RUNNING and self.setup.remote
        if driving and valid_command(self.remote, now_ns) is None:
            age = command_age(self.remote, now_ns)
            if isfinite(age):
                yield make_finding("W25", f"no valid command for {age * 1e3:.0f} ms")
            else:
                yield make_unknown("W25", "no valid command yet")

    def _find_failed_checks(
        self, now: WatchdogInput, findings: tuple[Finding, ...], estimated: bool, flags: int
    ) -> list[str]:
        """Pre-arm checks that fail, the cause before its consequences."""
        settings = self.setup.settings
        failed = [*check_vesc(self.vesc, settings.brakes), *check_flags(flags)]
        if not estimated:
            failed.append("an estimate: mocap must see the car for a moment, standing")
        failed += check_findings(findings)
        if estimated and self.setup.remote:
            failed += check_controller(valid_command(self.remote, now.t_ns) is not None)
        elif estimated:
            failed += check_lane(now.lateral_error, now.heading_error, settings.thresholds)
        if now.state is not SupervisorState.RUNNING:
            failed += check_motion(now.speed)
        return failed

    def _make_facts(
        self, now: WatchdogInput, estimate: StateEstimate | None, failed: list[str], flags: int
    ) -> int:
        setup, th = self.setup, self.setup.settings.thresholds
        known = self.vesc is not None and self.vesc.expected and self.vesc.timeout_ms is not None
        seen = self.perception.accepted_ns is not None and not flags & Flag.MOCAP_REFUSED
        running = now.state is SupervisorState.RUNNING
        over = setup.duration_ns is not None and now.t_ns - self._started_ns >= setup.duration_ns
        facts = Fact.SLOWING if is_slowing(self._watchdogs) else 0
        if flags & Flag.LINKED:
            facts |= Fact.LINKED
        if known and seen:
            facts |= Fact.IDENTIFIED
        if not failed:
            facts |= Fact.CHECKS_PASS
        if now.telemetry_age <= th.telemetry and self.perception.values.timeout_active:
            facts |= Fact.FW_TIMEOUT
        if now.lease_age <= th.lease:
            facts |= Fact.LEASED
        if running and over:
            facts |= Fact.ENDED
        if self._launch is not None and self._launch.done:
            facts |= Fact.LAUNCHED
        if estimate is not None and estimate.health.sound:
            facts |= Fact.ESTIMATED
        return facts

    def _timeout_ns(self) -> int:
        known = self.vesc.timeout_ms if self.vesc is not None else None
        return (known or 0) * 1_000_000

    def _merge_requests(self, flags: int) -> int:
        # Plain integers: an IntFlag "or" costs microseconds, and this runs on every tick.
        requests = self._requests_pending
        state = self.supervisor.state
        if flags & Flag.QUIT:
            requests |= int(Request.DISARM)
        if flags & Flag.ABORT:
            requests |= int(Request.ABORT)
        if self.setup.auto_arm and not self.ran and not flags & (Flag.QUIT | Flag.ABORT):
            if state is SupervisorState.READY:
                requests |= int(Request.ARM)
            elif state is SupervisorState.ARMED:
                requests |= int(Request.START)
        return requests

    def _apply_transition(
        self, old: SupervisorState, estimate: StateEstimate | None, now_ns: int, tripped: str
    ) -> None:
        """Start or end what a change of state starts or ends; `tripped`: the worst trip's text."""
        new = self.supervisor.state
        if new is SupervisorState.RUNNING and old is not SupervisorState.RUNNING:
            self._started_ns, self._launch, self.fault = now_ns, None, ""
            if estimate is not None:
                self._control = start_controller(self.adapting.controller, estimate.state, now_ns)
        if old in _DRIVING and new not in _DRIVING:
            self.ran, self._launch = True, None
        reason, hard = self.supervisor.reason, new in _HARD
        if new is not old and (hard or (is_engaged(old) and reason == tripped)):
            self.fault = reason
        if hard:
            self.live = relax(self.live, "a fault: path and gains as designed")
        rolling = abs(self.perception.wheel_speed) > STANDING_SPEED
        self.perception.may_rebase = new in _PARKED and not rolling

    def _remember_order(self, order: Order, now_ns: int) -> None:
        """Remember the order, for limiter, filter and controller."""
        self._limiter = order.limiter
        self._not_finite = order.verdict is Verdict.NOT_FINITE
        if order.command != self._issued:
            self.perception.on_command(now_ns, order.command)
        rolling = self.perception.wheel_speed
        self._following = send_order(
            self._following,
            self._ranges,
            now_ns,
            order.command,
            rolling if isfinite(rolling) else 0.0,
        )
        self.adapting = remember_order(self.adapting, now_ns, order.command)
        self._issued = order.command

    @property
    def faulted(self) -> bool:
        """Whether a safety stop ended the last drive."""
        return bool(self.fault)

    @property
    def parked(self) -> bool:
        """Whether no motor command is sent: disarmed, or latched."""
        return self.supervisor.state in _PARKED

    @property
    def at_rest(self) -> bool:
        """Whether this process may end: parked, or stopped by an emergency stop and standing."""
        s = self.supervisor
        return self.parked or (s.state is SupervisorState.ESTOP and stands(s, s.t_ns))
