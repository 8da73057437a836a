"""The control core without I/O: serial bytes and samples in, serial bytes and messages out.

Joins the VESC's protocol, the loop and the way out for messages. The real-time runner and virtual
time drive the same object.
"""

from steerd.daemon.ipc.outbox import Outbox
from steerd.daemon.loop.checks import VescInfo, check_vesc
from steerd.daemon.loop.failed_loop import describe_error, make_failed_tick
from steerd.daemon.loop.flags import Flag
from steerd.daemon.loop.loop import Loop, TickResult
from steerd.daemon.loop.outgoing import (
    make_actuation,
    make_diagnostics,
    make_imu,
    make_mocap,
    make_state,
    make_telemetry,
    make_transition,
)
from steerd.daemon.loop.supervisor import Action
from steerd.daemon.loop.transitions import SupervisorState
from steerd.mocap_link.source import PoseSample, SourceStatus
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.standard import Log, make_time
from steerd.vesc_link import events as e
from steerd.vesc_link.commands import GetMcConfTemp, SetCurrent, SetCurrentBrake
from steerd.vesc_link.events import DriveBrake, DriveSilent
from steerd.vesc_link.frames import encode_frame
from steerd.vesc_link.identity import McConfTemp
from steerd.vesc_link.packets import encode_command
from steerd.vesc_link.session_limits import limits_hold, make_restored_limits, make_session_limits
from steerd.vesc_link.vesc import VescLink

DIAGNOSTICS_PERIOD_NS = 500_000_000
BOUND_TRIES = 3
"""A frame may be lost; a VESC that will not take the session's limits is told so to people."""
_INFO, _WARN, _ERROR = 20, 30, 40
_ALARM = (SupervisorState.FAULT_STOP, SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP)


class Core:
    """One car's control core.

    Attributes:
        loop: decides.
        link: the VESC's protocol.
        outbox: messages on their way out.
        flags: what the runner reports; stays until it is taken back.
        last: the latest tick's result, or None.
        source: the mocap source's state as last told, for people.
        error: the first exception that nothing expected, or None.
    """

    def __init__(self, loop: Loop, link: VescLink, outbox: Outbox) -> None:
        self.loop = loop
        self.link = link
        self.outbox = outbox
        self.flags = 0
        self.last: TickResult | None = None
        self.source: SourceStatus | None = None
        self.error: BaseException | None = None
        self._uptime_ms = -1
        self._seq = 0
        self._ticked: m.Tick | None = None
        self._told_ns = -DIAGNOSTICS_PERIOD_NS
        self._limits_before: McConfTemp | None = None
        self._bound_tries = 0
        self._uuid: bytes | None = None
        self._expected = True
        self._mourned = False

    # --- events

    def on_serial(self, t_ns: int, data: bytes) -> None:
        """Bytes from the VESC; never raises."""
        try:
            self._on_serial(t_ns, data)
        except Exception as error:
            self.latch_exception(error)

    def _on_serial(self, t_ns: int, data: bytes) -> None:
        epoch = self.outbox.epoch_ns
        for event in self.link.on_bytes(t_ns, data):
            match event:
                case e.Telemetry():
                    self.loop.on_telemetry(event)
                    message = make_telemetry(event, self._uptime_ms, epoch)
                    self.outbox.post(topics.VESC, message, t_ns, event.when.stamp_ns)
                case e.ImuSample():
                    self.loop.on_imu(event)
                    self.outbox.post(topics.IMU, make_imu(event, epoch), t_ns, event.when.stamp_ns)
                case e.Uptime():
                    self._uptime_ms = event.uptime_ms
                case e.Rebooted():
                    self.flags |= Flag.REBOOTED
                    self._bound_tries = 0
                case e.Identity():
                    self._know(event)
                    self._tell_identity(t_ns)
                case e.AppConfRead():
                    self._tell_identity(t_ns)
                case e.LimitsRead():
                    self._bound_session(event.limits)
                case _:
                    pass

    def _know(self, event: e.Identity) -> None:
        """One run drives one VESC: the first that is the car file's, if that names one."""
        uuid = event.version.uuid
        if event.expected and self._uuid is None:
            self._uuid = uuid
        self._expected = event.expected and uuid == self._uuid
        self._bound_tries = 0

    def _tell_identity(self, t_ns: int) -> None:
        version, appconf = self.link.version, self.link.appconf
        if version is None:
            return
        vesc = VescInfo(
            self._expected,
            version.uuid.hex() if version.uuid else "",
            (version.firmware.major, version.firmware.minor),
            appconf.timeout_ms if appconf else None,
            appconf.timeout_brake_current if appconf else None,
        )
        self.loop.on_vesc(vesc)
        message = make_identity(vesc, t_ns, self.outbox.epoch_ns)
        self.outbox.post(topics.IDENTITY, message, t_ns)

    def _bound_session(self, limits: McConfTemp) -> None:
        """Give the VESC this session's limits, in RAM only: it holds them whatever happens here.

        It loses them when it starts anew, so that whatever is read is compared with them.
        """
        if not self._expected:
            return
        self._limits_before = self._limits_before or limits
        scaling = self.loop.setup.settings.scaling
        erpm_max = abs(scaling.erpm_gain) * self.loop.setup.settings.limits.speed_max * 1.2
        bounds = make_session_limits(limits, min(erpm_max, scaling.erpm_max))
        if limits_hold(bounds, limits):
            self.flags &= ~Flag.UNBOUNDED
        elif self._bound_tries < BOUND_TRIES:
            self._bound_tries += 1
            self.link.request(bounds)
            self.link.request(GetMcConfTemp())
        else:
            self.flags |= Flag.UNBOUNDED

    def brake_frame(self) -> bytes:
        """The frame with which a guardian stops the car."""
        current = self.loop.setup.settings.brakes.brake_current_a
        return encode_frame(encode_command(SetCurrentBrake(current)))

    def latch_exception(self, error: BaseException) -> None:
        """An exception that nothing expects, wherever it was raised: stop for good (W29)."""
        self.flags |= Flag.EXCEPTION
        self.error = self.error or error

    def make_shutdown_frames(self) -> bytes:
        """Frames for a car at rest: let the motor go, give the VESC its own limits back."""
        frames = encode_frame(encode_command(SetCurrent(0.0)))
        if self._limits_before is not None and self._expected:
            frames += encode_frame(encode_command(make_restored_limits(self._limits_before)))
        return frames

    def on_poses(self, samples: list[PoseSample]) -> None:
        """Mocap samples, in order of arrival; never raises."""
        try:
            for sample in samples:
                self.loop.on_pose(sample)
                message = make_mocap(sample, self.outbox.epoch_ns)
                self.outbox.post(topics.MOCAP, message, sample.t_arrival_ns, sample.t_valid_ns)
        except Exception as error:
            self.latch_exception(error)

    def on_request(self, name: str, data: bytes, t_ns: int) -> bool:
        """A message for the car from outside; False if it is not one."""
        try:
            if name == topics.OPERATOR.name:
                asked = decode(m.OperatorRequest, data)
                self.loop.on_operator(asked, t_ns)
                self.outbox.post(topics.OPERATOR, asked, t_ns)
                return True
            if name == topics.DRIVE.name:
                command = decode(m.DriveCommand, data)
                self.loop.on_drive(command, t_ns)
                self.outbox.post(topics.DRIVE, command, t_ns)
                return True
        except CodecError:
            return False
        return False

    # --- the tick

    def tick(self, due_ns: int, now_ns: int, work_ns: int = 0) -> bytes:
        """Decide, and give the bytes of this tick's one write; then `tell` what was written."""
        flags = int(self.flags)
        self.flags &= ~(Flag.REBOOTED | Flag.SUSPENDED)
        self.on_serial(now_ns, b"")
        self._seq += 1
        self.last = self._decide(due_ns, now_ns, flags)
        wire = self._wire(self.last.order.drive, now_ns)
        header = m.make_header(now_ns + self.outbox.epoch_ns, m.BODY)
        self._ticked = m.Tick(header, due_ns, now_ns, work_ns, self._seq & 0xFFFFFFFF, flags)
        return wire

    def post_tick(self, written: bytes) -> None:
        """Tell of the tick, when its bytes are on their way: a car cannot wait, messages can.

        Never raises: what cannot be told stops the car.
        """
        try:
            if self.last is not None and self._ticked is not None:
                self._tell_tick(self.last, self._ticked, written)
        except Exception as error:
            self.latch_exception(error)

    def _tell_tick(self, result: TickResult, tick: m.Tick, written: bytes) -> None:
        now_ns, epoch = tick.woke_ns, self.outbox.epoch_ns
        self.outbox.post(topics.TICK, tick, now_ns)
        drive = result.order.drive
        told = make_actuation(drive, written, self._seq, now_ns + epoch)
        self.outbox.post(topics.ACTUATION, told, now_ns)
        state = make_state(
            result.estimate,
            result.report,
            drive,
            result.supervisor.state,
            result.facts,
            self._seq,
            now_ns,
            epoch,
        )
        self.outbox.post(topics.STATE, state, now_ns)
        self._tell(result, now_ns)
        self.outbox.flush(now_ns)

    def _decide(self, due_ns: int, now_ns: int, flags: int) -> TickResult:
        """What the loop decides; if it raises, the car brakes in this very tick and for good."""
        try:
            return self.loop.tick(due_ns, now_ns, flags)
        except Exception as error:
            self.latch_exception(error)
            return make_failed_tick(self.loop, error, now_ns, bool(flags & Flag.LINKED))

    def _wire(self, drive: e.Drive, now_ns: int) -> bytes:
        """This tick's bytes: drive order and polls, and connecting where that is not done."""
        if not self.flags & Flag.LINKED:
            return b""
        try:
            wire = self.link.make_tick(drive, now_ns)
        except ValueError:
            brake = DriveBrake(None, self.loop.setup.settings.brakes.brake_current_a)
            wire = self.link.make_tick(brake, now_ns)
        if not self.link.ready and isinstance(drive, DriveSilent | DriveBrake):
            wire += self.link.make_connect(now_ns)
        return wire

    def _tell(self, result: TickResult, now_ns: int) -> None:
        stamp_ns = now_ns + self.outbox.epoch_ns
        if self.error is not None and not self._mourned:
            self._mourned = True
            self._log(_ERROR, f"W29 {describe_error(self.error)}", now_ns)
        changed = result.supervisor.state is not result.old
        if changed:
            transition = make_transition(result.old, result.supervisor, stamp_ns)
            self.outbox.post(topics.TRANSITION, transition, now_ns)
            level = _ERROR if result.supervisor.state in _ALARM else _INFO
            text = f"{result.supervisor.state.name}: {result.supervisor.reason}"
            self._log(level, text, now_ns)
        if changed or now_ns - self._told_ns >= DIAGNOSTICS_PERIOD_NS:
            self._told_ns = now_ns
            diagnostics = make_diagnostics(
                result.supervisor,
                result.action,
                self._waiting(result.action, result.waiting),
                result.findings,
                self._extra(),
                stamp_ns,
            )
            self.outbox.post(topics.DIAGNOSTICS, diagnostics, now_ns)

    def _log(self, level: int, text: str, now_ns: int) -> None:
        log = Log(make_time(now_ns + self.outbox.epoch_ns), level, "steerd", text, "", "", 0)
        self.outbox.post(topics.LOG, log, now_ns)

    def _waiting(self, action: Action, waiting: str) -> str:
        """What the loop waits for, made concrete where only the links know."""
        if action.waiting != waiting or self.loop.supervisor.state is not SupervisorState.INIT:
            return waiting
        if not self.flags & Flag.LINKED:
            return "the serial port to open"
        if self.loop.vesc is None:
            return "the VESC to answer: is it powered, and is this its port?"
        if not self.loop.vesc.expected:
            return next(check_vesc(self.loop.vesc, self.loop.setup.settings.brakes))
        if self.loop.perception.accepted_ns is None:
            detail = f" ({self.source.detail})" if self.source and self.source.detail else ""
            return f"a first pose of the car from mocap{detail}"
        return waiting

    def _extra(self) -> dict[str, str]:
        vesc, source = self.loop.vesc, self.source
        telling = {"boot_id": str(self.loop.setup.boot_id), "holder": str(self.loop.lease.holder)}
        telling["controller"] = "remote" if self.loop.setup.remote else "lane"
        if vesc is not None:
            telling["uuid"] = vesc.uuid
            telling["firmware"] = f"{vesc.firmware[0]}.{vesc.firmware[1]:02d}"
            telling["vesc_timeout_ms"] = str(vesc.timeout_ms)
        if source is not None:
            telling["mocap"] = source.state
            telling["mocap_rate_hz"] = f"{source.rate_hz:.0f}"
            telling["mocap_detail"] = source.detail
        return telling


def make_identity(vesc: VescInfo, t_ns: int, epoch_ns: int) -> m.VescIdentity:
    """What the VESC told about itself, as a message."""
    brake = vesc.timeout_brake_current
    return m.VescIdentity(
        m.make_header(t_ns + epoch_ns, m.BODY),
        t_ns,
        -1 if vesc.timeout_ms is None else vesc.timeout_ms,
        int(vesc.expected),
        vesc.firmware[0],
        vesc.firmware[1],
        float("nan") if brake is None else brake,
        vesc.uuid,
    )


def read_identity(message: m.VescIdentity) -> VescInfo:
    """The inverse of `make_identity`."""
    known = message.timeout_ms >= 0
    return VescInfo(
        bool(message.expected),
        message.uuid,
        (message.fw_major, message.fw_minor),
        message.timeout_ms if known else None,
        message.timeout_brake_current if known else None,
    )
