"""What the core watches: its guardian (W16), a stop's way from the bus (W27), who made a tick late.

Late is the machine's host, the whole machine, or this program alone. The guardian is the witness: a
process of its own, of the highest priority, that wakes every 10 ms. Where it stood still together
with the control core, so did everything.
"""

# Why: docs/decisions/safety.md#d35, docs/decisions/safety.md#d113

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from steerd.daemon.loop.findings import Flag
from steerd.daemon.process import heartbeat
from steerd.daemon.process.guardian import PERIOD_NS
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.messages import BODY, Heartbeat, make_header

START_NS = 1_000_000_000  # time that a new guardian has until its first heartbeat
STALE_NS_SIMULATED = 300_000_000  # age of the core's heartbeat that trips on simulated hardware
SILENT_S = Thresholds().guardian


def make_page_fd() -> int:
    """Return the fd of a fresh page, inheritable, to be mapped by core and guardian."""
    fd = os.memfd_create("steerd-heartbeat", 0)
    os.truncate(fd, heartbeat.PAGE_BYTES)
    return fd


def find_pause(page: heartbeat.HeartbeatPage | None, now_ns: int) -> tuple[int, int] | None:
    """The guardian's last pause, which may go on; (0, 0): none; None: it never lived."""
    if page is None or not page.words.guardian_ns:
        return None
    alive_ns = page.words.guardian_ns
    if now_ns - alive_ns > heartbeat.PAUSE_NS:
        return alive_ns, now_ns
    return page.words.pause_from_ns, page.words.pause_to_ns


class ProcessGuard:
    """A guardian process per opened port.

    Args:
        realtime: whether the core has a fixed priority; without, its heartbeat may be later.
        simulated: the hardware is simulated; a machine that stalls must not end the run.
        silent_s: largest age of the guardian's own heartbeat (W16) [s].
    """

    def __init__(
        self, realtime: bool, *, simulated: bool = False, silent_s: float = SILENT_S
    ) -> None:
        self._silent_ns = round(silent_s * 1e9)
        self._stale_ns = heartbeat.STALE_NS if realtime else heartbeat.STALE_NS_NO_RT
        if simulated:
            self._stale_ns = STALE_NS_SIMULATED
        self.page: heartbeat.HeartbeatPage | None = None  # shared with the newest guardian
        self._process: subprocess.Popen[bytes] | None = None
        self._started_ns = 0
        # Kept while their guardians live: the kernel walks through them when this thread dies.
        self._lifelines: list[tuple[subprocess.Popen[bytes], heartbeat.Lifeline]] = []

    def watch(self, serial_fd: int, brake_frame: bytes, t_ns: int) -> None:
        """Start a guardian for a port that was just opened."""
        self.mark_clean()
        self._forget_ended_guardians()
        page_fd = make_page_fd()
        pid_fd = os.pidfd_open(os.getpid())
        fds = (serial_fd, page_fd, pid_fd)
        command = [sys.executable, "-I", "-m", "steerd.daemon.process.guardian", *map(str, fds)]
        command += [brake_frame.hex(), str(self._stale_ns)]
        self.page = heartbeat.HeartbeatPage(page_fd)
        self.page.write_heartbeat(t_ns, engaged=False)
        lifeline = heartbeat.Lifeline(page_fd)
        lifeline.hold()
        self._process = subprocess.Popen(command, pass_fds=fds, process_group=0)
        self._lifelines.append((self._process, lifeline))
        self._started_ns = t_ns
        os.close(page_fd)
        os.close(pid_fd)

    def _forget_ended_guardians(self) -> None:
        """Forget guardians that have ended; a port that is reopened often must not leak them."""
        gone = [pair for pair in self._lifelines if pair[0].poll() is not None]
        self._lifelines = [pair for pair in self._lifelines if pair not in gone]
        for _, lifeline in gone:
            lifeline.release()

    def may_write(self, tick_ns: int, now_ns: int) -> bool:
        """Whether a motion frame may go out: the guardian has not tripped, the tick is fresh."""
        return self.page is not None and self.page.may_write(tick_ns, now_ns, self._stale_ns)

    def is_silent(self, now_ns: int) -> bool:
        """Whether the guardian is gone or its heartbeat is too old (W16)."""
        if self.page is None or self._process is None:
            return False
        alive_ns = self.page.words.guardian_ns
        if now_ns - self._started_ns < START_NS and not alive_ns:
            return False
        stale = now_ns - alive_ns > max(self._silent_ns, self._stale_ns)
        return stale or self._process.poll() is not None

    def has_tripped(self) -> bool:
        """Whether the guardian has taken over."""
        return self.page is not None and self.page.words.tripped_ns != 0

    def mark_clean(self) -> None:
        """The wheels stand: the guardian ends with the core and does not brake."""
        if self.page is not None:
            self.page.words.clean = 1


def sleep_lag_ns() -> int:
    """Time that the machine was suspended since boot [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


_STAT = Path("/proc/stat")
_STEAL = 8  # column of the stolen time in the line of all processors; see proc(5)
STALL_SHARE = 0.5  # of a tick's lateness: so much was stolen where the machine stood still


def parse_steal(text: str, ticks_per_second: int) -> int:
    """Time stolen from all processors since boot [ns]; 0 where `/proc/stat` does not say."""
    columns = text.partition("\n")[0].split()
    if len(columns) <= _STEAL or columns[0] != "cpu" or not columns[_STEAL].isdigit():
        return 0
    return int(columns[_STEAL]) * 1_000_000_000 // ticks_per_second


def read_steal_ns() -> int:
    """Time stolen from all processors of this machine since boot [ns]; 0 without `/proc`."""
    try:
        return parse_steal(_STAT.read_text(encoding="ascii"), os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError):
        return 0


Span = tuple[int, int]  # from and to [ns]
LEAST_NS = 2 * PERIOD_NS  # of a shorter delay the guardian, which sleeps for 10 ms, is no witness


def find_cause(late: Span, stolen_ns: int, pause: Span | None) -> int:
    """Which flag a late tick gets; 0 where nobody can say.

    Args:
        late: from the time at which the tick was due to the time at which it began.
        stolen_ns: time that the host stole since shortly before it was due.
        pause: the guardian's last pause that was longer than its own sleep, (0, 0) if it never
            made one; None without a guardian.
    """
    length = late[1] - late[0]
    if length > 0 and stolen_ns >= STALL_SHARE * length:
        return Flag.STALLED
    if pause is None or length < LEAST_NS:
        return 0
    shared = min(late[1], pause[1]) - max(late[0], pause[0])
    overslept = pause[1] - pause[0] - PERIOD_NS
    if min(shared, overslept) >= STALL_SHARE * length:
        return Flag.ALL_LATE
    return Flag.ALONE_LATE if shared <= 0 else 0


BEAT_NS = 50_000_000  # time between two heartbeats


@dataclass(slots=True)
class RemotePath:
    """Heartbeats of one run, which leave by the gateway and must come back (W27).

    The way is core, gateway, bus, whoever holds the lease, bus, gateway, core. While nobody on the
    bus holds it, the gateway hears the heartbeat itself: a person may want to stop the car from
    there.
    """

    boot_id: int  # of this run; heartbeats of another are not ours
    holder: int = 0  # lease id of the operator who took the lease over the bus, 0 for nobody
    _asked: int = 0
    _due_ns: int = 0
    _back_ns: int = 0

    def make_beat(self, now_ns: int, epoch_ns: int) -> Heartbeat | None:
        """The next heartbeat, if it is due."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + BEAT_NS
        return Heartbeat(make_header(now_ns + epoch_ns, BODY), self.boot_id, 0, now_ns)

    def take(self, data: bytes, now_ns: int) -> None:
        """A heartbeat came back; one that does not decode, or is somebody else's, is none."""
        try:
            beat = decode(Heartbeat, data)
        except CodecError:
            return
        ours = beat.boot_id == self.boot_id and beat.lease_id == self._asked
        if ours and self._back_ns < beat.mono_ns <= now_ns:
            self._back_ns = beat.mono_ns

    def is_silent(self, held: bool, limit_s: float, now_ns: int) -> bool:
        """Whether too long no heartbeat came back from the holder, or `held` by none, the gateway.

        Until the first does, no car is armed; whoever takes the lease has `limit_s` to answer.
        """
        asked = self.holder if held else 0
        if asked != self._asked:
            self._asked, self._back_ns = asked, now_ns
        return now_ns - self._back_ns > limit_s * 1e9
