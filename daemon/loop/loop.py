"""The loop: events in, orders out. No clock, no I/O, no randomness.

The real-time runner, virtual time and replay drive the same loop: the same events in the same order
give the same orders. Decisions are made by the pure functions that it calls; the loop takes the
measurements that they judge, and keeps their states from tick to tick.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from math import isfinite, nan
from typing import Any

from steerd.car_model.actuators import references
from steerd.car_model.model import believed_car
from steerd.car_model.ops import FLOAT
from steerd.car_model.state import Command, State
from steerd.controller.lane_controller import ControllerState, ControlReport, start_controller
from steerd.controller.limits import Verdict, make_limiter_state
from steerd.controller.live import AS_DESIGNED
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.plans import Drill
from steerd.daemon.loop import adapting, checks, following
from steerd.daemon.loop import findings as fs
from steerd.daemon.loop import lease as leases
from steerd.daemon.loop import supervisor as sv
from steerd.daemon.loop.adapting import read_design
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.follow_model import make_follow_model
from steerd.daemon.loop.live import judge_both_lanes, make_live, relax, step_live, take_request
from steerd.daemon.loop.outgoing import Order, TickResult, make_order
from steerd.daemon.loop.perception import NO_STATE, Perception, best_speed
from steerd.daemon.loop.transitions import BRAKED, DRIVING, PARKED, Fact, SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogInput, WatchdogState, step_watchdogs
from steerd.daemon.settings.thresholds import LAUNCH_SPEED
from steerd.estimator.state_filter import StateEstimate
from steerd.steer_bus import messages as m

_RELOCATE_TICKS = 25  # a parked car may be carried: its place on the path is searched so often
_LEASE_KEPT_S = 1.0  # a silent operator keeps the lease so long while the car is not parked [s]


class Loop:
    """The control loop's state.

    Attributes:
        perception: measurements, which are handed to it, and the state estimate.
        lease, remote: the operator and the external controller.
        vesc: what the VESC reported about itself, or None.
        fault: why a watchdog, a fault stop or an emergency stop ended the last drive, or nothing.
        ran: a drive has ended in this run.
    """

    def __init__(self, plan: RunPlan) -> None:
        s = plan.settings
        self.plan = plan
        car = believed_car(s.file.model)
        self.perception = Perception(car, s)
        self.supervisor = sv.make_supervisor_memory(0)
        self.lease = leases.Lease(plan.run.boot_id)
        self.remote = leases.Remote(leases.Lease(plan.run.boot_id))
        self.live = make_live(plan.live)
        self.adapting = adapting.make_adapting(plan.controller, plan.learnt, s.thresholds.lateral)
        self.vesc: m.VescIdentity | None = None
        self.fault = ""
        self.ran = False
        self._limiter = make_limiter_state(s.limits, Command(0.0, 0.0), 0)
        self._issued: Command[float] | None = None
        self._control: ControllerState | None = None
        self._car, self._ranges = car, make_follow_model(car, s.file.sd, s.filter, s.thresholds)
        self._following = following.FollowState()
        self._watchdogs = WatchdogState()
        self._lateness = fs.Lateness()
        hardware = fs.make_lateness_rules(s.thresholds)
        self._late_rules = fs.IN_SIMULATION if plan.options.simulated else hardware
        # The launch checks of this drive, and whether they have passed
        self._launch: checks.LaunchState | None = None
        self._launched = False
        self._not_finite = False
        self._requests_pending = 0
        self._started_ns = 0
        self._ticks = 0

    def on_vesc(self, vesc: m.VescIdentity | None) -> None:
        """The VESC reported about itself, or is gone (None)."""
        self.vesc = vesc

    def on_operator(self, message: m.OperatorRequest, t_ns: int) -> None:
        """An operator's request arrived."""
        before = self.lease.holder
        self.lease, request = leases.accept_request(self.lease, message, t_ns, self._is_idle(t_ns))
        self._requests_pending |= request
        self._pass_on(before)

    def on_parameters(self, message: m.ParameterRequest, t_ns: int) -> None:
        """A request for other live parameters arrived."""
        before = self.lease.holder
        self.lease, admitted = leases.admit(self.lease, message, t_ns, self._is_idle(t_ns))
        self._pass_on(before)
        self.live = take_request(self.live, message, admitted)

    def _is_idle(self, t_ns: int) -> bool:
        """Whether the operator has been silent for so long that another may take over."""
        parked = self.supervisor.state in PARKED
        patience_s = self.plan.settings.thresholds.lease if parked else _LEASE_KEPT_S
        return leases.lease_age(self.lease, t_ns) > patience_s

    def _pass_on(self, before: int) -> None:
        """An operator does not inherit what another tuned; without a deadman there is no holder."""
        if self.plan.run.leased and before not in (0, self.lease.holder):
            self.live = relax(self.live, "another operator: path and gains as designed")

    def on_drive(self, command: m.DriveCommand, t_ns: int) -> None:
        """An external controller's command arrived."""
        self.remote = leases.take_command(self.remote, command, t_ns)

    def on_design(self, message: m.Design, t_ns: int) -> None:
        """A design was taken; who hands it over has checked it, or reads what was recorded."""
        design = read_design(message)
        self.adapting = adapting.take_design(
            self.adapting, message.number, design, message.text, t_ns
        )

    def tick(self, due_ns: int, now_ns: int, flags: int) -> TickResult:
        """Decide what goes on the wire now."""
        estimate = self.perception.estimate(now_ns)
        speed = best_speed(estimate, self.perception.recent_wheel_speed(now_ns))
        wish, report = self._make_wish(estimate, now_ns)
        old, settings = self.supervisor.state, self.plan.settings
        reported = tuple(self._find_reported(estimate, due_ns, now_ns, flags))
        now, findings = self._watch(now_ns, estimate, report, speed, reported)
        failures = checks.find_failures(
            self.plan, self.vesc, self.remote, now, findings, flags, estimated=report is not None
        )
        failed = next(failures, "")
        bits, text = fs.summarise(findings)
        facts = bits | self._make_facts(now, estimate, failed, flags)
        vesc = self.vesc
        timeout_ns = 0 if vesc is None or vesc.timeout_ms < 0 else vesc.timeout_ms * 1_000_000
        conditions = sv.Conditions(facts, speed, timeout_ns, text)
        starts = self.plan.options.auto_arm and not self.ran
        requests = fs.merge_requests(self._requests_pending, flags, old, starts=starts)
        self.supervisor, action = sv.step_supervisor(self.supervisor, conditions, requests, now_ns)
        self._requests_pending = 0
        self._apply_transition(old, estimate, now_ns, text)
        order = make_order(settings, self._limiter, action, wish, speed, now_ns)
        self._remember_order(order, now_ns)
        disarmed = self.supervisor.state is SupervisorState.DISARMED
        waiting = failed if failed and disarmed else sv.WAITING[self.supervisor.state]
        return TickResult(order, old, self.supervisor, estimate, report, findings, waiting, facts)

    def fail(self, why: str, now_ns: int, linked: bool) -> TickResult:
        """Decide a tick without the part that failed: an armed car brakes and latches (W29)."""
        finding = fs.make_finding("W29", why)
        bits, text = fs.summarise((finding,))
        facts = bits | Fact.IDENTIFIED | Fact.SLOWING | (Fact.LINKED if linked else 0)
        settings, speed = self.plan.settings, self.perception.recent_wheel_speed(now_ns)
        old, conditions = self.supervisor.state, sv.Conditions(facts, speed, 0, text)
        self.supervisor, action = sv.step_supervisor(self.supervisor, conditions, 0, now_ns)
        new = self.supervisor.state
        if new is SupervisorState.FAULT_STOP:
            self.fault = self.supervisor.reason
        self.ran = self.ran or (old in DRIVING and new not in DRIVING)
        limiter = make_limiter_state(settings.limits, Command(0.0, 0.0), now_ns)
        order = make_order(settings, limiter, action, None, speed, now_ns)
        order = replace(order, drive=replace(order.drive, steer=None))
        return TickResult(
            order, old, self.supervisor, None, None, (finding,), sv.WAITING[new], facts
        )

    def _make_wish(
        self, estimate: StateEstimate | None, now_ns: int
    ) -> tuple[Command[float] | None, ControlReport | None]:
        """The controller's command and its report on the lane errors."""
        if estimate is None or not estimate.health.sound:
            self._control = None
            self.adapting = adapting.lose_estimate(self.adapting)
            return None, None
        self._ticks += 1
        self.live = step_live(self.live, now_ns, self.supervisor.state in PARKED)
        lost = self.supervisor.state in PARKED and self._ticks % _RELOCATE_TICKS == 0
        if self._control is None or lost:
            design = self.adapting.controller
            self._control = start_controller(design, estimate.state, now_ns)
        state = self.supervisor.state
        wish, report, self._control, self.adapting = adapting.steer(
            self.adapting, self._control, estimate.state, now_ns,
            issued=self._issued, driving=state in DRIVING,
            stop=state is not SupervisorState.RUNNING,
            live=self.live.now if self.plan.live else AS_DESIGNED,
        )  # fmt: skip
        if self.plan.remote:
            return self._make_remote_wish(now_ns), report
        if self.plan.drill is not None:
            return self._apply_drill(self.plan.drill, wish, now_ns), report
        return wish, report

    def _apply_drill(self, drill: Drill, lane: Command[float], now_ns: int) -> Command[float]:
        """The excitation plan's command; outside the drive the steering angle stays."""
        if self.supervisor.state is SupervisorState.RUNNING:
            return drill.wish((now_ns - self._started_ns) * 1e-9, lane)
        return lane if drill.closed else Command(self._limiter.order.steer, lane.speed)

    def _make_remote_wish(self, now_ns: int) -> Command[float] | None:
        command = leases.valid_command(self.remote, now_ns)
        if command is not None:
            return Command(command.steer, command.speed)
        # Lost while driving: hold the angle; the stop that follows takes the speed away.
        held = self._limiter.order
        return held if self.supervisor.state in DRIVING else None

    def _make_facts(
        self, now: WatchdogInput, estimate: StateEstimate | None, failed: str, flags: int
    ) -> int:
        plan, th, vesc = self.plan, self.plan.settings.thresholds, self.vesc
        known = vesc is not None and vesc.expected == 1 and vesc.timeout_ms >= 0
        seen = self.perception.accepted_ns is not None and not flags & Flag.MOCAP_REFUSED
        over = plan.duration_ns is not None and now.t_ns - self._started_ns >= plan.duration_ns
        shown = now.telemetry_age <= th.telemetry and now.status & 1 == 1
        return (
            Fact.SLOWING * (self._watchdogs.weak == 0)
            | Fact.LINKED * (flags & Flag.LINKED != 0)
            | Fact.IDENTIFIED * (known and seen)
            | Fact.CHECKS_PASS * (not failed)
            | Fact.FW_TIMEOUT * shown
            | Fact.LEASED * (now.lease_age <= th.lease)
            | Fact.ENDED * (now.state is SupervisorState.RUNNING and over)
            | Fact.LAUNCHED * self._launched
            | Fact.ESTIMATED * (estimate is not None and estimate.health.sound)
        )

    def _apply_transition(
        self, old: SupervisorState, estimate: StateEstimate | None, now_ns: int, tripped: str
    ) -> None:
        """Start or end what a change of state starts or ends; `tripped`: the worst trip's text."""
        new = self.supervisor.state
        if new is SupervisorState.RUNNING and old is not SupervisorState.RUNNING:
            self._started_ns, self.fault = now_ns, ""
            self._launch, self._launched = None, False
            if estimate is not None:
                self._control = start_controller(self.adapting.controller, estimate.state, now_ns)
        if old in DRIVING and new not in DRIVING:
            self.ran = True
            self._launch, self._launched = None, False
        reason, hard = self.supervisor.reason, new in BRAKED
        if new is not old and (hard or (old.engaged and reason == tripped)):
            self.fault = reason
        if hard:
            self.live = relax(self.live, "a fault: path and gains as designed")
        rolling = abs(self.perception.wheel_speed) > sv.STILL_SPEED
        self.perception.may_rebase = new in PARKED and not rolling

    def _remember_order(self, order: Order, now_ns: int) -> None:
        """Remember the order, for limiter, filter, watchdogs and controller."""
        self._limiter = order.limiter
        if order.command != self._issued:
            self.perception.on_command(now_ns, order.command)
        self._not_finite = order.verdict is Verdict.NOT_FINITE
        rolling = self.perception.wheel_speed
        speed = rolling if isfinite(rolling) else 0.0
        self._following = following.send_order(
            self._following, self._ranges, now_ns, order.command, speed
        )
        self.adapting = adapting.remember_order(self.adapting, now_ns, order.command)
        self._issued = order.command

    def _watch(
        self,
        now_ns: int,
        estimate: StateEstimate | None,
        report: ControlReport | None,
        speed: float,
        reported: tuple[fs.Finding, ...],
    ) -> tuple[WatchdogInput, tuple[fs.Finding, ...]]:
        """The measurements of a tick, NaN where nothing is known, and all findings.

        `speed` is the best known [m/s]; `reported` is of `_find_reported`.
        """
        plan, settings, seen = self.plan, self.plan.settings, self.perception
        state, order = self.supervisor.state, self._limiter.order
        limits, brakes = settings.limits, settings.brakes
        lane = judge_both_lanes(report, self.live.now)
        s, health = (estimate.state, estimate.health) if estimate else (NO_STATE, None)
        v, (e1, e2) = seen.values, (lane.e1, lane.e2) if lane else (nan, nan)
        if plan.ignores_lane:
            e1 = e2 = 0.0
        steer_max = limits.steer_left_max if order.steer > 0.0 else limits.steer_right_max
        now = WatchdogInput(
            t_ns=now_ns,
            state=state,
            pose=seen.watch,
            mocap_age=seen.mocap_age(now_ns),
            telemetry_age=seen.telemetry_age(now_ns),
            lease_age=leases.lease_age(self.lease, now_ns) if plan.run.leased else 0.0,
            speed=speed,
            speed_erpm=seen.wheel_speed,
            speed_mocap=seen.mocap_speed,
            speed_limit=limits.speed_max if self._launched else min(LAUNCH_SPEED, limits.speed_max),
            x=s.x,
            y=s.y,
            course=s.yaw + s.slip_angle,
            sigma_position=health.position_sd if health else nan,
            sigma_yaw=health.yaw_sd if health else nan,
            covariance_ok=health.sound if health else True,  # its sigmas are not known: W6 trips
            lateral_error=e1,
            heading_error=e2,
            steer_share=abs(order.steer) / steer_max,
            status=v.status if v.status > 0 else 0,  # -1: not sent
            fault_code=v.fault_code if v.fault_code > 0 else 0,
            tachometer=v.tachometer_abs,
            cell_voltage=v.v_in / brakes.cells,
            fet_temperature=v.temp_fet,
            motor_temperature=v.temp_motor,
            current_share=abs(v.current_motor) / brakes.current_max_a,
            followed=self._compare_with_orders(now_ns),
            reported=reported,
        )
        self._watchdogs, found = step_watchdogs(settings.thresholds, self._watchdogs, now)
        advised = found and plan.options.simulated
        return now, tuple(map(fs.advise_simulation, found)) if advised else found

    def _find_reported(
        self, estimate: StateEstimate | None, due_ns: int, now_ns: int, flags: int
    ) -> Iterator[fs.Finding]:
        """Findings that are not by measurements: of the processes, the tick, a start, commands."""
        yield from fs.make_reported_findings(flags)
        self._lateness, late = fs.step_lateness(
            self._lateness, due_ns, now_ns, self.plan.period_ns, self._late_rules
        )
        if late is not None:
            yield fs.blame_late(late, flags)
        running = self.supervisor.state is SupervisorState.RUNNING
        if running and estimate is not None and not self._launched:
            yield from self._check_launch(estimate.state, self._limiter.order, now_ns)
        if self._not_finite:
            yield fs.make_finding("limiter", "the controller gave a number that is not finite")
        if running and self.plan.remote and leases.valid_command(self.remote, now_ns) is None:
            age = leases.lease_age(self.remote.lease, now_ns)
            known = fs.make_finding("W25", f"no valid command for {age * 1e3:.0f} ms")
            yield known if isfinite(age) else fs.make_unknown("W25", "no valid command yet")

    def _check_launch(self, s: State[float], order: Command[float], t_ns: int) -> list[fs.Finding]:
        aim = references(FLOAT, self._car, order)  # gain and bias of the linkage
        now = checks.LaunchInput(t_ns, s.x, s.y, s.yaw, self.perception.wheel_speed, aim.steer)
        if self._launch is None:
            self._launch = checks.LaunchState(now, now.x, now.y)
            return []
        self._launch, wrong = checks.step_launch(
            self._launch, now, self.plan.settings.limits.wheelbase
        )
        self._launched = self._launch.done
        return [fs.make_finding("launch", wrong)] if wrong else []

    def _compare_with_orders(self, now_ns: int) -> following.Followed:
        """What wheels and pose did since, against the orders that left."""
        seen = self.perception
        ground = seen.mocap_speed if isfinite(seen.mocap_speed) else 0.0
        self._following = following.advance(self._following, self._ranges, now_ns, ground)
        turns = following.measure_turns(
            seen.track, following.follow_span(self.plan.settings.thresholds, ground)
        )
        return following.compare(self._following, self._ranges, seen.wheel, turns)

    @property
    def faulted(self) -> bool:
        """Whether a safety stop ended the last drive."""
        return bool(self.fault)

    @property
    def parked(self) -> bool:
        """Whether no motor command is sent: disarmed, or latched."""
        return self.supervisor.state in PARKED

    @property
    def at_rest(self) -> bool:
        """Whether this process may end: parked, or stopped by an emergency stop and standing."""
        s = self.supervisor
        return self.parked or (s.state is SupervisorState.ESTOP and sv.stands(s, s.t_ns))


REQUESTS: Mapping[type, Callable[[Loop, Any, int], None]] = {
    m.OperatorRequest: Loop.on_operator, m.DriveCommand: Loop.on_drive,
    m.ParameterRequest: Loop.on_parameters, m.Design: Loop.on_design,
}  # fmt: skip
"""What takes a message that was sent to the loop, with the time at which it arrived."""
