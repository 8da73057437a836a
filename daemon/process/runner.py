"""The real-time runner: one thread, one select, absolute deadlines.

Serial port, mocap sockets and requests are handled as they arrive. With a pose, or at the deadline
if none comes, the core ticks and its bytes are written. The deadlines follow the poses
(`steerd.daemon.process.pacing`). Missed ticks are skipped, never caught up in a burst.
"""

import contextlib
import os
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass

from steerd.daemon.ipc.pipe_records import PipeWriter
from steerd.daemon.ipc.requests import REQUEST_MAX, unpack_request
from steerd.daemon.ipc.signals import ALIVE, READY, STOPPING, Notify
from steerd.daemon.loop.adapting import DESIGN_BYTES
from steerd.daemon.loop.core import Core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.lease import lease_age
from steerd.daemon.process import guard as guards
from steerd.daemon.process.pacing import Pace, early_window_ns, step_pace
from steerd.mocap_link.sockets import MocapReceiver
from steerd.mocap_link.source import Pose
from steerd.mocap_link.zenoh_pose import BusPoseSource
from steerd.steer_bus import topics
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.messages import BODY, ClockSample, make_header
from steerd.vesc_link.transport import LinkDown, Port, PortError

REOPEN_NS = 200_000_000  # time between two attempts to open the serial port
MOCAP_TIMER_NS = 10_000_000  # time between two calls of the mocap source's timer
CLOCK_NS = 1_000_000_000  # time between two clock messages
_PACKETS_MAX = 32  # requests read from a socket at once: a flood of them must not delay the tick
_DESIGNS_MAX = 4  # proposals of the learner read after a tick
_KEY_BYTES = 64  # room for the topic name in a request
LEAVE_SIGNALS = 3  # so many stop signals end the process at once; the guardian brakes what moves
ABORT_NS, ORPHAN_NS = 2_000_000_000, 6_000_000_000
"""A second signal, or the parent's end, ends the process after this, whatever its state."""

_HEARTBEATS = (topics.HEARTBEAT.name, topics.HEARTBEAT_BACK.name)


@dataclass(frozen=True)
class CoreLinks:
    """The core's links to the other processes."""

    recorder: PipeWriter
    gateway: PipeWriter
    requests: tuple[socket.socket, ...]  # sockets on which requests arrive, the parent's first
    stop_fd: int  # gives a byte for each stop signal
    designs: socket.socket | None = None  # on which the learner's proposals arrive, or None


class Runner:
    """The control core in real time.

    `open_port` opens the serial port or raises PortError: it is called again later.
    """

    def __init__(
        self,
        core: Core,
        clock: Clock,
        open_port: Callable[[], Port],
        mocap: MocapReceiver | BusPoseSource,
        links: CoreLinks,
        guard: guards.ProcessGuard,
        notify: Notify = lambda _text: None,
    ) -> None:
        self._core = core
        self._notify = notify
        self._clock = clock
        self._open_port = open_port
        self._mocap = mocap
        self._links = links
        self._parent = links.requests[0] if links.requests else None
        self._requests = {end.fileno(): end for end in links.requests}
        self._designs = links.designs
        self._guard = guard
        self._port: Port | None = None
        self._period_ns = core.loop.plan.period_ns
        self._reopen_ns = self._mocap_ns = self._clock_ns = 0
        self._clogged = 0
        self._pose_ns = -1
        self._slept_ns, self._stolen_ns = guards.sleep_lag_ns(), guards.read_steal_ns()
        self._path = guards.RemotePath(core.loop.plan.run.boot_id)
        self._leave_ns: int | None = None
        self.signals = 0

    def run(self) -> None:
        """Run until a stop signal or the end of the planned drive, and the car is at rest."""
        self._notify(READY)
        due = self._clock.now_ns()
        work_ns, pace = 0, Pace()
        while not self._is_done():
            # Only a pose that came since the last tick makes one.
            self._wait(due, max(due - early_window_ns(pace, self._period_ns), self._pose_ns + 1))
            now = self._clock.now_ns()
            self._set_flags(now - due)
            wire = self._core.tick(due, now, work_ns)
            self._core.post_tick(self._write(wire, now))
            after = self._clock.now_ns()
            work_ns = after - now
            self._housekeeping(after)
            pace = step_pace(pace, due, self._pose_ns, self._period_ns)
            due += self._period_ns + pace.shift_ns
            if now > due:  # not by `after`: a tick that took too long makes the next one late
                due += (now - due) // self._period_ns * self._period_ns
        self._leave()

    def _is_done(self) -> bool:
        """Whether the run is over: drive ended or stop signal received, and the car at rest.

        The third signal ends it at once, the second and the parent's end within a bound; the
        guardian then brakes a car that moves.
        """
        loop = self._core.loop
        planned = loop.plan.duration_ns is not None and loop.ran
        # Nobody stands by to restart a drive by itself, and a process that is lost stays lost.
        alone = loop.plan.options.auto_arm
        lost = alone and self._core.flags & (Flag.RECORDER_LOST | Flag.GATEWAY_LOST)
        over = self.signals or planned or lost
        late = self._leave_ns is not None and self._clock.now_ns() >= self._leave_ns
        return late or self.signals >= LEAVE_SIGNALS or bool(over and loop.at_rest)

    def _take_signals(self, count: int, within_ns: int | None) -> None:
        """Stop; leave within so long at the latest, with the second signal after a hard stop's."""
        self.signals += count
        within_ns = ABORT_NS if self.signals > 1 else within_ns
        if within_ns is not None:
            due_ns = self._clock.now_ns() + within_ns
            self._leave_ns = min(due_ns, self._leave_ns or due_ns)

    def _wait(self, due_ns: int, early_ns: int) -> None:
        """Handle what arrives until the deadline, or until a pose has come since `early_ns`."""
        socketed = None if isinstance(self._mocap, BusPoseSource) else self._mocap
        while True:
            left_ns = due_ns - self._clock.now_ns()
            fds = [self._links.stop_fd, *self._requests]
            if self._port is not None:
                fds.append(self._port.fd)
            if socketed is not None:
                fds += socketed.fds()
            ready, _, _ = select.select(fds, [], [], max(left_ns, 0) * 1e-9)
            for fd in ready:
                self._try(self._take, fd)
            if left_ns <= 0 or early_ns <= self._pose_ns:
                return

    def _try(self, take: Callable[[int], None], what: int) -> None:
        """Handle an input; an unexpected exception stops the car (W29)."""
        try:
            take(what)
        except Exception as error:
            self._core.latch_exception(error)

    def _take(self, fd: int) -> None:
        if self._port is not None and fd == self._port.fd:
            self._read_serial()
        elif fd == self._links.stop_fd:
            with contextlib.suppress(BlockingIOError):
                self._take_signals(len(os.read(fd, 16)), None)
        elif fd in self._requests:
            self._read_requests(self._requests[fd])
        elif not isinstance(self._mocap, BusPoseSource) and fd in self._mocap.fds():
            self._on_poses(self._mocap.read_ready(fd))

    def _on_poses(self, samples: list[Pose]) -> None:
        if samples:  # never ahead of now: a wrong stamp must not bring ticks without waiting
            self._pose_ns = min(samples[-1].t_arrival_ns, self._clock.now_ns())
        self._core.on_poses(samples)

    def _read_requests(self, end: socket.socket) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(_PACKETS_MAX):
                packet = end.recv(REQUEST_MAX + _KEY_BYTES)
                if not packet:
                    self._close_requests(end)
                    return
                self._on_request(packet, end)

    def _on_request(self, packet: bytes, end: socket.socket) -> None:
        name, data = unpack_request(packet)
        now = self._clock.now_ns()
        if name == topics.EXTERNAL_POSE.name and isinstance(self._mocap, BusPoseSource):
            sample = self._mocap.on_message(data, now)
            self._on_poses([sample] if sample else [])
        elif name in _HEARTBEATS:
            self._path.take(data, now)
        else:
            before = self._core.loop.lease.holder
            self._core.on_request(name, data, now)
            if (holder := self._core.loop.lease.holder) != before:
                self._path.holder = 0 if end is self._parent else holder

    def _close_requests(self, end: socket.socket) -> None:
        """A process that sends requests has ended: the gateway, or the parent, which means quit."""
        if end is self._parent:
            self._take_signals(1, ORPHAN_NS)
        else:
            self._core.flags |= Flag.GATEWAY_LOST
        self._requests.pop(end.fileno(), None)
        end.close()

    def _read_designs(self, now_ns: int) -> None:
        """The newest of a few proposals a tick: a flood of them waits in the socket."""
        end, newest = self._designs, b""
        if end is None:
            return
        with contextlib.suppress(BlockingIOError):
            for _ in range(_DESIGNS_MAX):
                try:
                    newest = end.recv(DESIGN_BYTES + 1)
                except ConnectionResetError:
                    newest = b""
                if not newest:  # the learner has ended, which the loop sees by its silence
                    end.close()
                    self._designs = None
                    return
        if newest:
            self._core.on_proposal(newest, now_ns)

    def _set_flags(self, late_ns: int = 0) -> None:
        """Set the flags that the next tick needs, which is late by so much."""
        if late_ns > self._period_ns:
            now = self._clock.now_ns()
            stolen_ns = guards.read_steal_ns() - self._stolen_ns
            pause = guards.find_pause(self._guard.page, now)
            self._core.flags |= guards.find_cause((now - late_ns, now), stolen_ns, pause)
        lag = guards.sleep_lag_ns()
        if lag - self._slept_ns > self._core.loop.plan.settings.thresholds.suspend_step * 1e9:
            self._core.flags |= Flag.SUSPENDED
        self._slept_ns = lag
        if self.signals:
            self._core.flags |= Flag.QUIT
        if self.signals > 1:
            self._core.flags |= Flag.ABORT

    def _housekeeping(self, now_ns: int) -> None:
        """Work that can wait until after the tick."""
        if self._port is None and now_ns >= self._reopen_ns:
            self._try(self._try_open, now_ns)
        if now_ns >= self._mocap_ns:
            self._mocap_ns = now_ns + MOCAP_TIMER_NS
            self._try(self._step_mocap, now_ns)
        if now_ns >= self._clock_ns:
            self._clock_ns = now_ns + CLOCK_NS
            self._post_clock(now_ns)
            self._stolen_ns = guards.read_steal_ns()
        beat = self._path.make_beat(now_ns, self._core.outbox.epoch_ns)
        if beat is not None:
            self._core.outbox.post(topics.HEARTBEAT, beat, now_ns)
        self._try(self._read_designs, now_ns)
        self._watch_processes(now_ns)

    def _step_mocap(self, now_ns: int) -> None:
        self._core.feed_back(self._mocap.ingest)
        self._mocap.on_timer(self._clock.now_ns())
        self._core.on_source(self._mocap.status())

    def _post_clock(self, now_ns: int) -> None:
        self._notify(ALIVE)
        realtime = self._clock.realtime_ns()
        header = make_header(now_ns + self._core.outbox.epoch_ns, BODY)
        self._core.outbox.post(topics.CLOCK, ClockSample(header, realtime, now_ns, 0), now_ns)

    def _watch_processes(self, now_ns: int) -> None:
        links, core, settings = self._links, self._core, self._core.loop.plan.settings
        th = settings.thresholds
        if settings.record.required and _is_lost(links.recorder, th.recorder_full, now_ns):
            core.flags |= Flag.RECORDER_LOST
        lost = _is_lost(links.gateway, th.gateway_full, now_ns) or self._is_cut_off(now_ns)
        self._hold(Flag.GATEWAY_LOST, lost)
        if self._port is not None:  # one that is slow to start is a failed pre-arm check, no fault
            self._hold(Flag.GUARDIAN_LOST, self._guard.is_silent(now_ns))
        if self._guard.has_tripped():
            core.flags |= Flag.GUARDIAN_TRIPPED

    def _is_cut_off(self, now_ns: int) -> bool:
        """Whether a stop from the bus would not arrive (W27); simulated cars stand in no lane."""
        loop = self._core.loop
        th, plan = loop.plan.settings.thresholds, loop.plan
        held = plan.run.leased and lease_age(loop.lease, now_ns) <= th.lease
        return self._path.is_silent(held, th.gateway_full, now_ns) and not plan.options.simulated

    def _hold(self, flag: int, lost: bool) -> None:
        """Raise a flag; it goes only when nothing is lost and no motor bytes may flow."""
        if lost:
            self._core.flags |= flag
        elif not self._core.loop.supervisor.state.engaged:
            self._core.flags &= ~flag

    def _try_open(self, now_ns: int) -> None:
        self._reopen_ns = now_ns + REOPEN_NS
        if not self._core.may_link:
            return
        try:
            self._port = self._open_port()
        except PortError:
            return
        self._guard.watch(self._port.fd, self._core.brake_frame(), now_ns)
        self._core.open_link()

    def _read_serial(self) -> None:
        if self._port is None:
            return
        try:
            data = self._port.read()
        except PortError:
            self._lose_port()
            return
        self._core.on_serial(self._clock.now_ns(), data)

    def _write(self, wire: bytes, tick_ns: int) -> bytes:
        """Send the heartbeat and write a tick's bytes; return what was written."""
        page = self._guard.page
        if self._port is None or page is None:
            return b""
        last = self._core.last
        engaged = last is not None and last.supervisor.state.engaged
        page.write_heartbeat(tick_ns, engaged)
        staged: bytes | memoryview = wire
        try:
            self._check_queue(self._port, engaged)
            if last is not None and last.order.command is not None:
                staged = page.stage(wire)
                if not self._guard.may_write(tick_ns, self._clock.now_ns()):
                    self._core.flags |= Flag.GUARDIAN_TRIPPED
                    return b""
            if wire:
                self._port.write(staged)
        except LinkDown:
            self._lose_port()
            return b""
        return wire

    def _check_queue(self, port: Port, engaged: bool) -> None:
        """Look whether an armed car's device has taken the bytes of the last tick (W8).

        Not those of this one: Linux counts a USB write on its way as a whole buffer, 1280 bytes.

        Raises:
            LinkDown: it has not for some ticks, or is gone.
        """
        th = self._core.loop.plan.settings.thresholds
        waits = engaged and port.out_queue() > th.out_queue
        self._clogged = self._clogged + 1 if waits else 0
        if self._clogged >= th.out_ticks:
            raise LinkDown(port.url, "the device takes no bytes")

    def _lose_port(self) -> None:
        port, self._port = self._port, None
        self._clogged = 0
        if not self._core.loop.supervisor.state.engaged:
            self._guard.mark_clean()  # it holds the port too, which must come free to be reopened
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()
        self._core.lose_link()

    def _leave(self) -> None:
        """Close everything; at rest, the VESC gets its own limits back.

        In motion, the guardian sees only the end of this process, and brakes.
        """
        self._notify(STOPPING)
        now = self._clock.now_ns()
        if self._port is not None:
            if self._core.loop.at_rest:
                self._guard.mark_clean()
                with contextlib.suppress(PortError):
                    self._port.write(self._core.make_shutdown_frames())
            with contextlib.suppress(OSError):
                self._port.close()
        self._core.outbox.flush(now)
        if not isinstance(self._mocap, BusPoseSource):
            self._mocap.close()


def _is_lost(pipe: PipeWriter, timeout_s: float, now_ns: int) -> bool:
    """Whether a reader is gone, or has read nothing for too long (W26, W27)."""
    full_ns = pipe.full_since_ns
    return pipe.dead or (full_ns is not None and now_ns - full_ns > timeout_s * 1e9)
