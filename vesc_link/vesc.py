"""Client of one VESC without I/O: bytes in, events out; drive orders in, bytes out.

The owner calls `VescLink.make_connect` until `VescLink.ready`, then `VescLink.make_tick` once per
tick, writes what it returns in one write, and hands whatever it reads to `VescLink.on_bytes`
(once per tick even when nothing arrived, so that expiry is noticed). ALIVE is never sent: it would
keep the last motor command running although this program hangs.
"""

from collections import deque
from math import inf, nan

from steerd.steer_bus.messages import ActuationMode
from steerd.steer_bus.quick_values import quick_value
from steerd.vesc_link import commands as c
from steerd.vesc_link import ids, packets
from steerd.vesc_link import telemetry as t
from steerd.vesc_link.commands import Command
from steerd.vesc_link.frames import MAX_PAYLOAD, RUNNING_CEILING, Frame, FrameParser, encode_frame
from steerd.vesc_link.identity import AppConf, FwVersion, McConfTemp
from steerd.vesc_link.scaling import Scaling, speed_to_erpm, steer_to_servo_pos

WRITE_LIMIT = 64
"""One write per tick fits one USB packet [bytes]."""
EXPIRY_NS = 80_000_000
"""How long a request may stay open."""
POLL_EXPIRY_NS = 15_000_000
"""A poll is repeated soon: five tries fit into the 100 ms of silence that stop a car."""
UPTIME_PERIOD_NS = 1_000_000_000
CONNECT_TRIES = 5
"""How often a configuration is requested before the link goes on without it."""

FIRST_KNOWN_APPCONF = ids.Firmware(3, 55)
"""Older app configurations may begin with other fields (`docs/reference/vesc-serial.md#v2.6`)."""

_NOT_BY_REQUEST = (*packets.FEEDS_TIMEOUT, c.SetServoPos, c.Reboot)


@quick_value
class Drive:
    """An order for motor and servo; by default none, so that the VESC's own timeout can strike."""

    # SPEED follows `speed`; BRAKE brakes with `current`, which must be repeated; SHORT sets the
    # duty cycle zero, the second means when brake current has no effect; RELEASE lets the car
    # coast; SILENT sends no motor command
    mode: ActuationMode = ActuationMode.SILENT
    steer: float | None = None  # road-wheel angle [rad, left positive]; None leaves the servo alone
    speed: float = nan  # [m/s]
    current: float = nan  # [A]


@quick_value
class Answer:
    """A reply to a request; the measurement lies between the two times [ns, monotonic]."""

    reply: packets.Reply  # what the VESC said
    t_sent_ns: int  # when the request was written
    t_received_ns: int  # when the reply's first byte was read

    @property
    def stamp_ns(self) -> int:
        """Estimate of the time of measurement: the middle."""
        return (self.t_sent_ns + self.t_received_ns) // 2


@quick_value
class Rebooted:
    """The VESC restarted: session limits are gone and its tachometer began anew."""

    reason: str
    t_received_ns: int


Event = Answer | Rebooted


_MASKED = (t.Values, t.Uptime, t.Imu)


@quick_value
class _Request:
    """A command as it goes out; an answer has its number, and its mask where it has one."""

    command: Command
    number: ids.CommandId
    frame: bytes
    mask: int | None
    polled: bool
    answered: bool


@quick_value
class _Open:
    """A request that waits for its answer."""

    request: _Request
    t_sent_ns: int
    t_earliest_ns: int


class VescLink:
    """Protocol state of one VESC.

    Args:
        scaling: calibration of the car.
        expected_uuid: the 12 bytes that must answer; None takes any VESC.

    Attributes:
        version, firmware, appconf, limits: what the VESC said; None until it did.
        parser: its frames.
    """

    def __init__(self, scaling: Scaling, expected_uuid: bytes | None = None) -> None:
        self._scaling = scaling
        self._expected_uuid = expected_uuid
        self.reset()

    def reset(self) -> None:
        """Forget the device, as after a reopen."""
        self.parser = FrameParser()
        self.version: FwVersion | None = None
        self.firmware: ids.Firmware | None = None
        self.appconf: AppConf | None = None
        self.limits: McConfTemp | None = None
        self._polls: tuple[_Request, ...] = ()
        self._uptime_poll: _Request | None = None
        self._open: dict[ids.CommandId, _Open] = {}
        self._just_expired: dict[ids.CommandId, int] = {}
        self._tries: dict[ids.CommandId, int] = {}
        self._queue: deque[Command] = deque()
        self._uptime_due_ns = -inf
        self._fault = 0
        self._uptime_ms = 0
        self._tachometer_abs = 0

    @property
    def ready(self) -> bool:
        """Whether the connect sequence is over (`appconf` may be None: it did not answer)."""
        if self.firmware is None:
            return False
        known = self.appconf is not None and self.limits is not None
        return known or self._connect_step() is None

    @property
    def expected(self) -> bool:
        """Whether the VESC that answered last is the one that was demanded."""
        uuid = None if self.version is None else self.version.uuid
        return self._expected_uuid in (None, uuid)

    def request(self, command: Command) -> None:
        """Send a one-off command with one of the next ticks that has room for it.

        SET_MCCONF_TEMP (50 bytes) has room only in a tick without motor command.

        Raises:
            ValueError: a command that drives, steers or restarts: ticks alone drive.
        """
        if isinstance(command, _NOT_BY_REQUEST):
            raise ValueError(f"{type(command).__name__} is not sent on request")
        packets.encode_command(command, self.firmware or ids.FW_7_01)
        self._queue.append(command)

    # --- host to VESC ---------------------------------------------------------------------------

    def make_connect(self, t_ns: int) -> bytes:
        """Next request of the connect sequence; empty while one is open or when all is known."""
        self._expire(t_ns)
        step = self._connect_step()
        if step is None or packets.command_number(step) in self._open:
            return b""
        request = _make_request(step, self.firmware or ids.FW_7_01)
        self._tries[request.number] = self._tries.get(request.number, 0) + 1
        self._note_sent(request, t_ns)
        return request.frame

    def _connect_step(self) -> Command | None:
        firmware = self.firmware
        if firmware is None:
            return c.GetFwVersion()
        steps: list[tuple[Command, ids.CommandId]] = []
        if self.appconf is None and firmware >= FIRST_KNOWN_APPCONF:
            steps.append((c.GetAppConf(), ids.CommandId.GET_APPCONF))
        if self.limits is None and ids.knows(firmware, ids.CommandId.GET_MCCONF_TEMP):
            steps.append((c.GetMcConfTemp(), ids.CommandId.GET_MCCONF_TEMP))
        for step, number in steps:
            if number in self._open or self._tries.get(number, 0) < CONNECT_TRIES:
                return step
        return None

    def make_tick(self, drive: Drive, t_ns: int) -> bytes:
        """All bytes of one tick: motor, servo, then as many polls as fit into 64 bytes.

        Raises:
            ValueError: the drive order holds NaN or infinity. Nothing was sent; brake.
        """
        self._expire(t_ns)
        firmware = self.firmware or ids.FW_7_01
        wire = b""
        for command in self._motion(drive):
            wire += encode_frame(packets.encode_command(command, firmware))
        for request in self._due(t_ns):
            longer = wire + request.frame
            if request.number in self._open or len(longer) > WRITE_LIMIT:
                continue
            wire = longer
            if self._queue and request.command is self._queue[0]:
                self._queue.popleft()
            self._note_sent(request, t_ns)
        return wire

    def _motion(self, drive: Drive) -> list[Command]:
        commands: list[Command] = []
        match drive.mode:
            case ActuationMode.SPEED:
                commands.append(c.SetErpm(speed_to_erpm(self._scaling, drive.speed)))
            case ActuationMode.BRAKE:
                commands.append(c.SetCurrentBrake(drive.current))
            case ActuationMode.SHORT:
                commands.append(c.SetDuty(0.0))
            case ActuationMode.RELEASE:
                commands.append(c.SetCurrent(0.0))
        if drive.steer is not None:
            commands.append(c.SetServoPos(steer_to_servo_pos(self._scaling, drive.steer)))
        return commands

    def _due(self, t_ns: int) -> tuple[_Request, ...]:
        """Requests that are due, the most important first."""
        due = self._polls
        if self._uptime_poll is not None and t_ns >= self._uptime_due_ns:
            due = (*due, self._uptime_poll)
        if self._queue and self.firmware is not None:
            due = (_make_request(self._queue[0], self.firmware), *due)
        return due

    def _make_polls(self, firmware: ids.Firmware) -> None:
        """What this firmware can be asked for: chosen values, its IMU, its uptime."""
        selective = ids.knows(firmware, ids.CommandId.GET_VALUES_SELECTIVE)
        polls: list[Command] = [c.GetValuesSelective(t.FAST_MASK) if selective else c.GetValues()]
        if ids.knows(firmware, ids.CommandId.GET_IMU_DATA):
            polls.append(c.GetImuData(t.IMU_ACCEL_GYRO_MASK))
        self._polls = tuple(_make_request(poll, firmware, polled=True) for poll in polls)
        uptime, timed = c.GetValuesSetupSelective(t.UPTIME_MASK), firmware >= ids.FW_5_03
        self._uptime_poll = _make_request(uptime, firmware, polled=True) if timed else None

    def _note_sent(self, request: _Request, t_ns: int) -> None:
        if request.answered:
            earliest = self._just_expired.pop(request.number, t_ns)
            still_possible = t_ns - earliest <= 2 * EXPIRY_NS
            self._open[request.number] = _Open(request, t_ns, earliest if still_possible else t_ns)
        if request.number is ids.CommandId.GET_VALUES_SETUP_SELECTIVE:
            self._uptime_due_ns = t_ns + UPTIME_PERIOD_NS

    def _expire(self, t_ns: int) -> None:
        if not self._open:
            return
        overdue_ns = t_ns - POLL_EXPIRY_NS
        for waits in self._open.values():
            if waits.t_sent_ns < overdue_ns:
                break
        else:
            return
        for number, waits in list(self._open.items()):
            patience = POLL_EXPIRY_NS if waits.request.polled else EXPIRY_NS
            if t_ns - waits.t_sent_ns > patience:
                del self._open[number]
                # The answer may still come, and then looks like that to the next request.
                self._just_expired[number] = waits.t_earliest_ns

    # --- VESC to host ---------------------------------------------------------------------------

    def on_bytes(self, t_ns: int, data: bytes) -> list[Event]:
        """Take bytes read at ``t_ns`` (or none) and return what they mean, in order."""
        events: list[Event] = []
        if data or self.parser.buffered:
            driving = self.ready and ids.CommandId.GET_APPCONF not in self._open
            self.parser.ceiling = RUNNING_CEILING if driving else MAX_PAYLOAD
            for frame in self.parser.feed_stamped(data, t_ns):
                events += self._on_frame(frame)
        if self._open:
            self._expire(t_ns)
        return events

    def _on_frame(self, frame: Frame) -> list[Event]:
        number = ids.command_id(frame.payload[0], self.firmware or ids.FW_7_01)
        waits = None if number is None else self._open.get(number)
        if number is None or waits is None:
            return []
        reply = packets.decode_numbered(number, frame.payload)
        if reply is None or self._is_odd(reply, len(frame.payload)):
            return []
        # A reply that names a mask answers the request for it; others answer by their id alone.
        if isinstance(reply, _MASKED) and reply.mask != waits.request.mask:
            return []
        del self._open[number]
        answer = Answer(reply, waits.t_earliest_ns, frame.t_first_ns)
        return [answer, *self._learn(reply, frame.t_first_ns)]

    def _is_odd(self, reply: packets.Reply, size: int) -> bool:
        """Whether a measurement is shorter than this firmware's; a newer one may send more."""
        if type(reply) is t.Imu:
            return size < 3 + 4 * reply.mask.bit_count()
        if type(reply) is not t.Values or self.firmware is None:
            return False
        expected = t.values_size(reply.mask, self.firmware)
        return size != expected if self.firmware <= ids.FW_3_00 else size < expected

    def _learn(self, reply: packets.Reply, t_ns: int) -> list[Event]:
        """Keep what the VESC said of itself; restarts that telemetry or its clock show."""
        match reply:
            case t.Values():
                return self._watch(reply, t_ns)
            case t.Uptime(uptime_ms=uptime_ms):
                went_back, self._uptime_ms = uptime_ms < self._uptime_ms, uptime_ms
                return [self._rebooted("its uptime went back", t_ns)] if went_back else []
            case FwVersion():
                self.version, self.firmware = reply, reply.firmware
                self._make_polls(reply.firmware)
            case AppConf():
                self.appconf = reply
            case McConfTemp():
                self.limits = reply
        return []

    def _watch(self, values: t.Values, t_ns: int) -> list[Event]:
        events: list[Event] = []
        fault = values.fault or 0
        if fault == ids.FAULT_WATCHDOG_BOOT and fault != self._fault:
            events.append(self._rebooted("its watchdog restarted it", t_ns))
        self._fault = fault
        if values.tachometer_abs is not None:
            if values.tachometer_abs < self._tachometer_abs:
                events.append(self._rebooted("its tachometer went back", t_ns))
            self._tachometer_abs = values.tachometer_abs
        return events

    def _rebooted(self, reason: str, t_ns: int) -> Rebooted:
        self.limits = None
        self._tries.clear()
        return Rebooted(reason, t_ns)


def _make_request(command: Command, firmware: ids.Firmware, *, polled: bool = False) -> _Request:
    return _Request(
        command,
        packets.command_number(command),
        encode_frame(packets.encode_command(command, firmware)),
        getattr(command, "mask", None),
        polled,
        packets.expects_reply(command),
    )
