"""The dashboard of a run in the terminal: state, errors, timing, warnings."""

import shlex
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import degrees, hypot, isfinite, remainder, sqrt, tau
from pathlib import Path

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from steerd.car_model.car_file import default_car_path
from steerd.daemon.assembly.build import RunPlan
from steerd.daemon.assembly.session_meta import sessions_folder
from steerd.daemon.common.screen import NBSP, below_home, remove_controls, show
from steerd.daemon.ipc.pipe_records import PipeRecord, read_message
from steerd.daemon.ipc.requests import read_diagnostics
from steerd.daemon.learning.reported import QUIET, design_text, gap_text
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.sessions.motion import SETTLE
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics

SETTLE_NS = round(SETTLE * 1e9)
_COLOURS = {"RUNNING": "green", "ARMED": "yellow", "FAULT_STOP": "red", "FAULT_LATCHED": "red",
            "ESTOP": "red", "STOPPING": "yellow"}  # fmt: skip
_ARMED = (SupervisorState.ARMED, SupervisorState.RUNNING)
_HARD = (SupervisorState.FAULT_STOP, SupervisorState.ESTOP)


@dataclass
class Tally:
    """Figures of one drive, from the states of every tick that was seen."""

    count: int = 0  # ticks after settling
    square: float = 0.0  # sum of squared lateral errors [m^2]
    worst: float = 0.0  # largest lateral error [m]
    distance: float = 0.0  # driven [m]
    driven_ns: int = 0  # time spent running [ns]
    _since_ns: int | None = None
    _last: tuple[int, float, float] | None = None

    def add(self, state: m.StateMessage) -> None:
        """Add the state of one tick."""
        if state.mode != SupervisorState.RUNNING:
            self._since_ns = self._last = None
            return
        if self._since_ns is None:
            self._since_ns = state.mono_ns
        if self._last is not None:
            t_ns, x, y = self._last
            self.distance += hypot(state.x - x, state.y - y)
            self.driven_ns += state.mono_ns - t_ns
        self._last = (state.mono_ns, state.x, state.y)
        if state.mono_ns - self._since_ns >= SETTLE_NS and isfinite(state.e1):
            self.count += 1
            self.square += state.e1 * state.e1
            self.worst = max(self.worst, abs(state.e1))

    @property
    def rms(self) -> float:
        """Root mean square of the lateral error after settling [m]; 0 without samples."""
        return sqrt(self.square / self.count) if self.count else 0.0

    def describe(self, *, lane: bool = True) -> str:
        """One line for the end of a run; `lane`: whether the car followed a path."""
        driven = f"drove {self.distance:.1f} m in {self.driven_ns * 1e-9:.1f} s"
        if not self.count or not lane:
            return driven
        errors = f"RMS {1e3 * self.rms:.1f} mm, largest {1e3 * self.worst:.1f} mm (after 3 s)"
        return f"{driven}; lateral error {errors}"


@dataclass
class Dashboard:
    """The latest messages of a run, for rendering; None before the first, or where there are none.

    `model` is what the learner reported last, `status` the diagnostics by name, `events` the latest
    transitions, a line each.
    """

    title: str  # of the panel
    state: m.StateMessage | None = None
    tick: m.Tick | None = None
    parameters: m.Parameters | None = None
    model: m.Model | None = None
    status: dict[str, str] = field(default_factory=dict)
    events: deque[str] = field(default_factory=lambda: deque(maxlen=6))
    stop: str = ""  # why the car was stopped last
    tally: Tally = field(default_factory=Tally)  # figures of the drive so far
    keys: str = ""  # help line of the keys; empty where there is no keyboard

    @property
    def boot_id(self) -> int:
        """Of the car's run; 0 before it is known."""
        return int(self.status.get("boot_id", "0") or 0)

    def take(self, record: PipeRecord) -> str | None:
        """Take in a record; returns a line to print where nothing is rendered, or None."""
        if record.topic is topics.STATE:
            state: m.StateMessage = read_message(record)
            self.state = state
            self.tally.add(state)
        elif record.topic is topics.TICK:
            self.tick = read_message(record)
        elif record.topic is topics.PARAMETERS:
            self.parameters = read_message(record)
        elif record.topic is topics.MODEL:
            return self._take_model(read_message(record))
        elif record.topic is topics.DIAGNOSTICS:
            self.status = read_diagnostics(read_message(record))
        elif record.topic is topics.TRANSITION:
            change: m.Transition = read_message(record)
            line = f"{SupervisorState(change.to_state).name:<14}{remove_controls(change.text)}"
            self.events.append(line)
            if change.to_state == SupervisorState.RUNNING:
                self.stop = ""
            elif change.from_state in _ARMED or change.to_state in _HARD:
                self.stop = change.text
            return line
        return None

    def _take_model(self, model: m.Model) -> str | None:
        """A line where the learner says something new of a change."""
        before, self.model = self.model, model
        reported = [(each.verdict, each.effect) for each in (before, model) if each is not None]
        if model.verdict in QUIET or (reported[0] == reported[-1] and len(reported) > 1):
            return None
        line = remove_controls(f"{'GAP':<14}{gap_text(model)}".replace(NBSP, " "))
        self.events.append(line)
        return line

    def render(self) -> RenderableType:
        """The panel."""
        name = self.status.get("state", "...")
        head = Text.assemble((f" {name} ", f"bold reverse {_COLOURS.get(name, 'cyan')}"), "  ")
        head.append(f"waiting for {self.status.get('waiting', 'the control core')}")
        parts: list[RenderableType] = [head, Text()]
        if self.state is not None:
            parts.append(self._numbers(self.state))
        warnings = [w for w in self.status.get("warnings", "").splitlines() if w]
        parts += [Text(f"! {w}", style="yellow") for w in warnings[:3]]
        if (p := self.parameters) is not None:
            line = f"live   speed up to {show(p.speed, '.2f')} m/s"
            line += f"   lane {show(1e3 * p.offset, '+.0f')} mm   gain {show(p.gain, '.2f')}"
            parts.append(Text(line))
            if p.seq and not p.accepted:  # why the last request was refused
                parts.append(Text(remove_controls(f"! {p.text}"), style="yellow"))
        if self.model is not None:
            style = "" if self.model.verdict in QUIET else "bold yellow"
            parts.append(Text(remove_controls(f"gap    {gap_text(self.model)}"), style=style))
        if "design" in self.status:
            parts.append(Text(f"design {design_text(self.status)}"))
        parts += [Text(), *(Text(line, style="dim") for line in self.events)]
        if self.keys:
            parts += [Text(), Text(self.keys, style="bold")]
        return Panel(Group(*parts), title=self.title, expand=True)

    def _numbers(self, s: m.StateMessage) -> Table:
        table = Table.grid(padding=(0, 3))
        late_ms = max(self.tick.woke_ns - self.tick.due_ns, 0) * 1e-6 if self.tick else 0.0
        work_ms = self.tick.work_ns * 1e-6 if self.tick else 0.0
        mocap, hz = (self.status.get(name, "?") for name in ("mocap", "mocap_rate_hz"))
        rows = (
            ("pose", f"x {show(s.x, '+7.3f')} m", f"y {show(s.y, '+7.3f')} m",
             f"yaw {show(degrees(remainder(s.yaw, tau)), '+7.1f')}°"),
            ("motion", f"v {show(s.speed, '+6.2f')} m/s", f"r {show(s.yaw_rate, '+6.2f')} rad/s",
             f"slip {show(degrees(s.slip_angle), '+5.1f')}°"),
            ("lane", f"e1 {show(1e3 * s.e1, '+6.1f')} mm", f"e2 {show(degrees(s.e2), '+6.2f')}°",
             f"RMS {1e3 * self.tally.rms:.1f} mm"),
            ("command", _format_command("steer", degrees(s.steer_ref), "6.2f", "°"),
             _format_command("speed", s.speed_ref, "5.2f", " m/s")),
            ("links", f"mocap {mocap} {hz} Hz", f"tick late {late_ms:.2f} ms",
             f"work {work_ms:.2f} ms"),
        )  # fmt: skip
        for row in rows:
            table.add_row(*row)
        return table


def _format_command(name: str, value: float, digits: str, unit: str) -> str:
    """A command, or a dash before the car is driven."""
    return f"{name} {value:+{digits}}{unit}" if isfinite(value) else f"{name} –"


def closing_lines(plan: RunPlan, tally: Tally, session: Path) -> Iterator[str]:
    """Distance, errors, session and next command; open-loop plans have no lateral error."""
    yield tally.describe(lane=plan.drill is None or plan.drill.closed)
    # Of a folder that nobody chose, commands find the last drive by themselves.
    usual = session.parent == sessions_folder()
    name = "@last" if usual else shlex.quote(str(session))
    yield f"session: {below_home(session) if usual else session}"
    if plan.drill is not None:
        own = plan.options.car_file not in ("", str(default_car_path()))
        car = f" --car {shlex.quote(plan.options.car_file)}" if own else ""
        yield f"   next: steerd identify {name}{car} -o car.toml"
    else:
        more = "learn" if plan.options.learn else "info"
        yield f"   next: steerd plot {name}   (or steerd {more})"
