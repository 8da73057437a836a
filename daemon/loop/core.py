"""The control core without I/O: serial bytes and samples in, serial bytes and messages out.

Joins the VESC's protocol, the loop and the outbox. The real-time runner and virtual time drive the
same object. After an exception (W29) a tick is decided by supervisor and brake only: filter,
controller and watchdogs do not run, because one of them has just raised, and the servo gets no new
angle, so it holds the last one.
"""

# Why: docs/decisions/safety.md#d42

import traceback
from collections.abc import Sequence

from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.ipc.pipe_records import Outbox, Sink
from steerd.daemon.loop import outgoing
from steerd.daemon.loop.adapting import DesignDesk
from steerd.daemon.loop.checks import check_vesc
from steerd.daemon.loop.findings import CAUSES, Flag
from steerd.daemon.loop.live import make_parameters
from steerd.daemon.loop.loop import REQUESTS, Loop
from steerd.daemon.loop.outgoing import TickResult
from steerd.daemon.loop.transitions import HELD, SupervisorState
from steerd.mocap_link.ingest import PoseIngest
from steerd.mocap_link.source import Pose, SourceStatus
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.standard import Log, make_time
from steerd.vesc_link import identity
from steerd.vesc_link.commands import Command, GetMcConfTemp, SetCurrent, SetCurrentBrake
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.packets import encode_command
from steerd.vesc_link.telemetry import Imu, Uptime, Values
from steerd.vesc_link.vesc import Answer, Drive, VescLink

DIAGNOSTICS_PERIOD_NS = 500_000_000  # longest time between two diagnostics messages
LIMITS_TRIES = 3  # the session's limits are sent so often: a frame may be lost; then a check fails
ERPM_MARGIN = 1.2  # the VESC's own speed limit over the car file's: the watchdogs come first
_INFO, _ERROR = 20, 40  # levels of `rcl_interfaces/Log`
_HANDSHAKE = (m.ActuationMode.SILENT, m.ActuationMode.BRAKE)
"""Orders beside which a tick's write has room for the questions at the start."""
_REQUESTS = {t.name: t for t in (topics.OPERATOR, topics.DRIVE, topics.SET_PARAMETERS)}
"""What others ask of the car, by its topic's name."""


class Core:
    """One car's control core.

    Attributes:
        flags: bits of `Flag` from the runner; they stay until the runner clears them.
        source: the latest status of the mocap source, for people.
        error: the first unexpected exception, or None.
    """

    def __init__(self, loop: Loop, link: VescLink, outbox: Outbox) -> None:
        self.loop = loop
        self.link = link
        self.outbox = outbox
        self.flags = 0
        self.last: TickResult | None = None
        self.source: SourceStatus | None = None
        self.designs = DesignDesk()
        self.error: BaseException | None = None
        self._uptime_ms = -1
        self._seq = 0
        self._tick: m.Tick | None = None
        self._diagnostics_ns = -DIAGNOSTICS_PERIOD_NS
        self._limits_before: identity.McConfTemp | None = None
        self._limits_tries = 0
        self._uuid: bytes | None = None
        self._expected = True
        self._error_logged = False

    @property
    def may_link(self) -> bool:
        """Whether a port may be opened: at a stop one that comes back takes brake frames only."""
        return self.loop.supervisor.state not in HELD

    def open_link(self) -> None:
        """The port is open; who the VESC is will be asked."""
        self.link.reset()
        self.flags |= Flag.LINKED
        self.flags &= ~(Flag.SERIAL_FAULT | Flag.GUARDIAN_LOST | Flag.GUARDIAN_TRIPPED)

    def lose_link(self) -> None:
        """The port is gone, or does not take its bytes (W8)."""
        self.flags |= Flag.SERIAL_FAULT
        self.flags &= ~Flag.LINKED
        self.link.reset()
        self.loop.on_vesc(None)

    def feed_back(self, ingest: PoseIngest) -> None:
        """Show the mocap pipeline what it needs of the car."""
        seen = self.loop.perception
        ingest.wheel_speed = seen.wheel_speed
        ingest.stationary = seen.may_rebase

    def on_source(self, source: SourceStatus) -> None:
        """How the mocap source is now."""
        self.source = source
        self.flags &= ~Flag.MOCAP_REFUSED
        self.flags |= Flag.MOCAP_REFUSED if source.refused else 0

    def on_serial(self, t_ns: int, data: bytes) -> None:
        """Bytes from the VESC; never raises."""
        try:
            for event in self.link.on_bytes(t_ns, data):
                if type(event) is Answer:
                    self._on_answer(t_ns, event)
                else:
                    self.flags |= Flag.REBOOTED
                    self._limits_tries = 0
        except Exception as error:
            self.latch_exception(error)

    def _on_answer(self, t_ns: int, answer: Answer) -> None:
        stamp_ns = answer.stamp_ns
        header = m.make_header(stamp_ns + self.outbox.epoch_ns, m.BODY)
        match answer.reply:
            case Values() as values:
                telemetry = outgoing.make_telemetry(header, answer, values, self._uptime_ms)
                self.loop.perception.on_telemetry(telemetry)
                self.outbox.post(topics.VESC, telemetry, t_ns, stamp_ns)
            case Imu() as imu:
                reading = outgoing.make_imu(header, answer, imu)
                self.loop.perception.on_imu(reading)
                self.outbox.post(topics.IMU, reading, t_ns, stamp_ns)
            case Uptime(uptime_ms=uptime_ms):
                self._uptime_ms = uptime_ms
            case identity.FwVersion(uuid=uuid):
                self._check_identity(uuid)
                self._post_identity(t_ns)
            case identity.AppConf():
                self._post_identity(t_ns)
            case identity.McConfTemp() as limits:
                self._apply_session_limits(limits)

    def _check_identity(self, uuid: bytes | None) -> None:
        """Accept one VESC per run: the first that matches the car file, if that names one."""
        if self.link.expected and self._uuid is None:
            self._uuid = uuid
        self._expected = self.link.expected and uuid == self._uuid
        self._limits_tries = 0

    def _post_identity(self, t_ns: int) -> None:
        version, appconf = self.link.version, self.link.appconf
        if version is None:
            return
        vesc = outgoing.make_identity(version, appconf, self._expected, t_ns, self.outbox.epoch_ns)
        self.loop.on_vesc(vesc)
        self.outbox.post(topics.IDENTITY, vesc, t_ns)

    def _apply_session_limits(self, limits: identity.McConfTemp) -> None:
        """Give the VESC this session's limits, in RAM only: it keeps them if this process dies.

        It loses them when it restarts, so that the limits that it reports are compared each time.
        """
        if not self._expected:
            return
        self._limits_before = self._limits_before or limits
        scaling = self.loop.plan.settings.scaling
        erpm_max = abs(scaling.erpm_gain) * self.loop.plan.settings.limits.speed_max * ERPM_MARGIN
        bounds = identity.make_session_limits(limits, min(erpm_max, scaling.erpm_max))
        if identity.limits_hold(bounds, limits):
            self.flags &= ~Flag.UNBOUNDED
        elif self._limits_tries < LIMITS_TRIES:
            self._limits_tries += 1
            self.link.request(bounds)
            self.link.request(GetMcConfTemp())
        else:
            self.flags |= Flag.UNBOUNDED

    def brake_frame(self) -> bytes:
        """The frame that the guardian writes to stop the car."""
        current = self.loop.plan.settings.brakes.brake_current_a
        return encode_frame(encode_command(SetCurrentBrake(current)))

    def latch_exception(self, error: BaseException) -> None:
        """An unexpected exception, wherever it was raised: stop and latch (W29)."""
        self.flags |= Flag.EXCEPTION
        self.error = self.error or error

    def make_shutdown_frames(self) -> bytes:
        """Frames for a car at rest: release the motor, restore the VESC's own limits."""
        commands: list[Command] = [SetCurrent(0.0)]
        if self._limits_before is not None and self._expected:
            commands.append(identity.make_restored_limits(self._limits_before))
        return b"".join(encode_frame(encode_command(command)) for command in commands)

    def on_poses(self, poses: list[Pose]) -> None:
        """Mocap's poses, in order of arrival; never raises."""
        try:
            for pose in poses:
                message = outgoing.make_mocap(pose, self.outbox.epoch_ns)
                self.loop.perception.on_pose(message)
                self.outbox.post(topics.MOCAP, message, pose.t_arrival_ns, pose.t_valid_ns)
        except Exception as error:
            self.latch_exception(error)

    def on_request(self, name: str, data: bytes, t_ns: int) -> bool:
        """A message for the car from outside; False if it is not one."""
        topic = _REQUESTS.get(name)
        if topic is None:
            return False
        try:
            request = decode(topic.message, data)
        except CodecError:
            return False
        REQUESTS[topic.message](self.loop, request, t_ns)
        self.outbox.post(topic, request, t_ns)
        if topic is topics.SET_PARAMETERS:
            self._post_parameters(t_ns)
        return True

    def on_proposal(self, data: bytes, t_ns: int) -> None:
        """The learner proposes a design; it is looked at after the next ticks."""
        self.designs.offer(self.loop.adapting, data, t_ns)

    def tick(self, due_ns: int, now_ns: int, work_ns: int = 0) -> bytes:
        """Decide; return the bytes of this tick's write. `post_tick` must follow it.

        If the loop raises, the car brakes in this very tick and latches.
        """
        flags = int(self.flags)
        self.flags &= ~(Flag.REBOOTED | Flag.SUSPENDED | CAUSES)
        self.on_serial(now_ns, b"")
        self._seq += 1
        try:
            self.last = self.loop.tick(due_ns, now_ns, flags)
        except Exception as error:
            self.latch_exception(error)
            self.last = self.loop.fail(describe_error(error), now_ns, bool(flags & Flag.LINKED))
        wire = self._make_wire(self.last.order.drive, now_ns)
        header = m.make_header(now_ns + self.outbox.epoch_ns, m.BODY)
        self._tick = m.Tick(header, due_ns, now_ns, work_ns, self._seq & 0xFFFFFFFF, flags)
        return wire

    def post_tick(self, written: bytes) -> None:
        """Post the tick's messages, after its bytes were written: messages can wait, a car cannot.

        Never raises; a message that cannot be encoded stops the car (W29).
        """
        result, tick = self.last, self._tick
        if result is None or tick is None:
            return
        now_ns, epoch, post = tick.woke_ns, self.outbox.epoch_ns, self.outbox.post
        try:
            post(topics.TICK, tick, now_ns)
            drive = result.order.drive
            actuation = outgoing.make_actuation(tick.header, drive, written, self._seq)
            post(topics.ACTUATION, actuation, now_ns)
            post(topics.STATE, outgoing.make_state(result, self._seq, now_ns, epoch), now_ns)
            self._post_changes(result, now_ns)
            # The learner's proposal is looked at a little more; one that passed is the next tick's.
            taken = self.designs.step(self.loop.adapting, now_ns, epoch)
            if taken is not None:
                self.loop.on_design(taken, now_ns)
                post(topics.DESIGN, taken, now_ns)
            self.outbox.flush(now_ns)
        except Exception as error:
            self.latch_exception(error)

    def _make_wire(self, drive: Drive, now_ns: int) -> bytes:
        """This tick's bytes: drive order and polls, and the handshake until it is done."""
        if not self.flags & Flag.LINKED:
            return b""
        try:
            wire = self.link.make_tick(drive, now_ns)
        except ValueError:
            brake = self.loop.plan.settings.brakes.brake_current_a
            wire = self.link.make_tick(Drive(m.ActuationMode.BRAKE, current=brake), now_ns)
        if not self.link.ready and drive.mode in _HANDSHAKE:
            wire += self.link.make_connect(now_ns)
        return wire

    def _post_changes(self, result: TickResult, now_ns: int) -> None:
        stamp_ns = now_ns + self.outbox.epoch_ns
        if self.error is not None and not self._error_logged:
            self._error_logged = True
            self._log(_ERROR, f"W29 {describe_error(self.error)}", now_ns)
        changed = result.supervisor.state is not result.old
        if changed:
            self.outbox.post(topics.TRANSITION, outgoing.make_transition(result, stamp_ns), now_ns)
            level = _ERROR if result.supervisor.state in outgoing.ALARM else _INFO
            text = f"{result.supervisor.state.name}: {result.supervisor.reason}"
            self._log(level, text, now_ns)
        if changed or now_ns - self._diagnostics_ns >= DIAGNOSTICS_PERIOD_NS:
            self._diagnostics_ns = now_ns
            waiting, extra = self._describe_waiting(result.waiting), self._make_extra_values()
            diagnostics = outgoing.make_diagnostics(result, waiting, extra, stamp_ns)
            self.outbox.post(topics.DIAGNOSTICS, diagnostics, now_ns)
            self._post_parameters(now_ns)

    def _post_parameters(self, now_ns: int) -> None:
        message = make_parameters(self.loop.live, now_ns + self.outbox.epoch_ns)
        if message is not None:
            self.outbox.post(topics.PARAMETERS, message, now_ns)

    def _log(self, level: int, text: str, now_ns: int) -> None:
        log = Log(make_time(now_ns + self.outbox.epoch_ns), level, "steerd", text, "", "", 0)
        self.outbox.post(topics.LOG, log, now_ns)

    def _describe_waiting(self, waiting: str) -> str:
        """What the loop waits for, in more detail where only the links know it."""
        if self.loop.supervisor.state is not SupervisorState.INIT:
            return waiting
        if not self.flags & Flag.LINKED:
            return "the serial port to open"
        if self.loop.vesc is None:
            return "the VESC to answer: is it powered, and is this its port?"
        if not self.loop.vesc.expected:
            return next(check_vesc(self.loop.vesc, self.loop.plan.settings.brakes))
        if self.loop.perception.accepted_ns is None:
            detail = f" ({self.source.detail})" if self.source and self.source.detail else ""
            return f"a first pose of the car from mocap{detail}"
        return waiting

    def _make_extra_values(self) -> dict[str, str]:
        vesc, source = self.loop.vesc, self.source
        values = {"boot_id": str(self.loop.plan.run.boot_id), "holder": str(self.loop.lease.holder)}
        values["leased"] = str(int(self.loop.plan.run.leased))
        values["controller"] = "remote" if self.loop.plan.remote else "lane"
        adapting = self.loop.adapting
        if adapting.held is not None:
            values["design"] = f"learnt {adapting.number}" if adapting.follows else "car file"
            values["design_why"] = adapting.why
        if vesc is not None:
            values["uuid"] = vesc.uuid
            values["firmware"] = f"{vesc.fw_major}.{vesc.fw_minor:02d}"
            values["vesc_timeout_ms"] = "None" if vesc.timeout_ms < 0 else str(vesc.timeout_ms)
        if source is not None:
            values["mocap"] = source.state
            values["mocap_rate_hz"] = f"{source.rate_hz:.0f}"
            values["mocap_detail"] = source.detail
        return values


def describe_error(error: BaseException) -> str:
    """Type, place and text of an exception on one line."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" at {frames[-1].name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}{place}: {error}"


def make_core(plan: RunPlan, sinks: Sequence[Sink]) -> Core:
    """The control core of a plan."""
    scaling, uuid = plan.settings.scaling, plan.settings.brakes.uuid
    link = VescLink(scaling, bytes.fromhex(uuid) if uuid else None)
    return Core(Loop(plan), link, Outbox(plan.run.epoch_ns, tuple(sinks)))
