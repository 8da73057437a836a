"""Any car on the bus in a terminal: the dashboard, and the message rate of each topic."""

import getpass
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import raw, show
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import REPEAT_NS, BusOperator, Pulse
from steerd.daemon.terminal import key_desk
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.clock import Clock, MonotonicClock
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.topics import ROOT, Sample, find_topic, make_key, split_key
from steerd.steer_bus.zenoh_bus import ZenohBus
from steerd.vesc_link.ids import fault_name

SECOND = 1_000_000_000
SILENT_NS = 1_500_000_000  # a car that sends nothing for this long is reported as silent [ns]
REFRESH_NS = 100_000_000  # time between two refreshes [ns]
DEPTH = 1024  # messages kept between two refreshes
_SHOWN = ("state", "tick", "mocap", "vesc", "imu", "actuation", "diagnostics")
"""Topics whose rates are shown."""
_TIMES_KEPT = 2048  # arrival times kept per topic; more than a second of the fastest topic


def find_car(bus: ZenohBus, name: str | None) -> str:
    """The named car, or the only one on the bus; a SteerdError without it, or for several."""
    cars = sorted(parts[0] for key in bus.alive(f"{ROOT}/*/alive") if (parts := split_key(key)))
    if name is not None and name in cars:
        return name
    if not cars:
        hint = "start `steerd run` first, or name its endpoint with --connect"
        raise SteerdError("no car is on the bus", hint, ExitCode.UNREACHABLE)
    listed = ", ".join(cars)
    if name is not None:
        raise SteerdError(f"no car {name!r} on the bus", f"--name {listed}", ExitCode.UNREACHABLE)
    if len(cars) > 1:
        raise UsageError("several cars are on the bus", f"--name, one of {listed}")
    return cars[0]


@dataclass
class Watch:
    """What was received from one car."""

    board: Dashboard  # the dashboard that it feeds
    vesc: m.VescTelemetry | None = None  # the last telemetry
    heard_ns: int | None = None  # arrival of the last message; None before the first
    undecodable: int = 0  # count of messages that do not decode as their topic's type
    _times: dict[str, deque[int]] = field(default_factory=dict)

    def take(self, sample: Sample, t_ns: int) -> str | None:
        """Take in a message; returns a line to print where nothing is rendered, or None."""
        topic = find_topic(sample.key)
        if topic is None or topic.direction == "in":
            return None
        self.heard_ns = t_ns
        self._times.setdefault(topic.name, deque(maxlen=_TIMES_KEPT)).append(t_ns)
        try:
            if topic is topics.VESC:
                self.vesc = decode(m.VescTelemetry, sample.data)
            return self.board.take(PipeRecord(topic, 0, t_ns, t_ns, sample.data))
        except (CodecError, SteerdError, ValueError):
            self.undecodable += 1
            return None

    def rates(self, t_ns: int) -> dict[str, float]:
        """Messages per second over the last second, by topic."""
        for times in self._times.values():
            while times and t_ns - times[0] > SECOND:
                times.popleft()
        return {name: float(len(times)) for name, times in sorted(self._times.items())}

    def silence(self, t_ns: int) -> float:
        """Time since the last message [s]; 0 before the first and while messages arrive."""
        if self.heard_ns is None or t_ns - self.heard_ns < SILENT_NS:
            return 0.0
        return (t_ns - self.heard_ns) * 1e-9

    def line(self, t_ns: int) -> str:
        """One line: for pipes and logs."""
        state, status = self.board.state, self.board.status
        if (silent := self.silence(t_ns)) > 0.0:
            return f"no message for {silent:.1f} s: is the daemon still running?"
        name, motion = status.get("state", "?"), "no state"
        if state is not None:
            name = SupervisorState(state.mode).name
            motion = f"{show(state.speed, '+.2f')} m/s, e1 {show(1e3 * state.e1, '+.1f')} mm"
        rates = self.rates(t_ns)
        shown = ", ".join(f"{key} {rates[key]:.0f}" for key in _SHOWN if key in rates)
        return f"{name:<14}{motion}; {shown} Hz; fault {self.fault}"

    @property
    def fault(self) -> str:
        """The VESC's name of its fault; `none` without one."""
        code = self.vesc.fault_code if self.vesc else 0
        return fault_name(code) if code > 0 else "none"

    def render(self, t_ns: int) -> RenderableType:
        """The dashboard, with message rates and the VESC's telemetry under it."""
        parts: list[RenderableType] = [self.board.render()]
        if (silent := self.silence(t_ns)) > 0.0:
            text = f" no message for {silent:.1f} s: is the daemon still running? "
            parts.append(Text(text, style="bold reverse red"))
        rates = self.rates(t_ns)
        cells = [f"{name} {rates[name]:.0f}" for name in _SHOWN if name in rates]
        parts += [Text("messages per second", style="dim"), Columns(cells, padding=(0, 2))]
        if self.vesc is not None:
            v = self.vesc
            figures = f"{show(v.v_in, '.1f')} V  {show(v.current_motor, '+.1f')} A"
            figures += f"  {show(v.temp_fet, '.0f')} °C  fault: {self.fault}"
            parts.append(Text(f"VESC  {figures}", "red" if v.fault_code > 0 else ""))
        if self.undecodable:
            parts.append(Text(f"{self.undecodable} messages of another steerd version", "yellow"))
        return Group(*parts)


def watch_car(bus: ZenohBus, name: str | None, seconds: float | None, *, operate: bool) -> None:
    """Show a car, see `find_car`, for so long [s]: on a terminal with keys, else in lines."""
    car, clock = find_car(bus, name), MonotonicClock()
    watch = Watch(Dashboard(f"steerd watch · {car}"))
    received = bus.subscribe(make_key(car, "*"), DEPTH)
    end = inf if seconds is None else clock.now_ns() + round(seconds * SECOND)
    console = Console(file=raw(sys.stdout))
    if not console.is_terminal:  # transitions at once, a line per second
        due = clock.now_ns() + SECOND
        while clock.now_ns() < end:
            for sample in received.poll():
                line = watch.take(sample, clock.now_ns())
                if line is not None:
                    print(line, flush=True)
            if clock.now_ns() >= due:
                due += SECOND
                print(watch.line(clock.now_ns()), flush=True)
            clock.sleep_until_ns(clock.now_ns() + REFRESH_NS)
        return
    desk, repeat = make_desk(watch.board, bus, car, clock, operate=operate)
    with key_desk.keys_one_by_one() as keys, Live(console=console, auto_refresh=False) as live:
        helps = [*([key_desk.KEY_HELP] if operate else []), key_desk.NUDGE_HELP]
        watch.board.keys = "" if keys is None else "\n".join(helps)
        shown_ns = 0
        while clock.now_ns() < end:
            for sample in received.poll():
                watch.take(sample, clock.now_ns())
            if (now := clock.now_ns()) - shown_ns >= REFRESH_NS:
                shown_ns = now
                live.update(watch.render(now), refresh=True)
            desk.keep_alive()
            repeat()
            for key in key_desk.wait_for_key(keys, REPEAT_NS, clock):
                desk.on_key(key)


def make_desk(
    board: Dashboard, bus: ZenohBus, car: str, clock: Clock, *, operate: bool
) -> tuple[key_desk.KeyDesk, Callable[[], bool]]:
    """The keys of a car, live ones alone unless `operate`; and what repeats a stop from there."""
    operator = BusOperator(bus, car, clock, getpass.getuser(), Pulse(bus, car))
    desk = key_desk.KeyDesk(
        board, clock,
        lambda kind: operator.ask(board.boot_id, kind),
        lambda wanted: operator.tune(board.boot_id, wanted),
        key_desk.KEYS if operate else {},
    )  # fmt: skip
    return desk, lambda: operator.repeat(board.state.mode if board.state else None)
