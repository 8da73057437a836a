"""Replay: the recorded events through the loop, in recorded order; its orders are compared.

The loop has no clock and no randomness, so the orders must be the recorded ones. If they differ,
the code has changed since the drive, or the loop has an input that is not recorded.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isnan
from typing import Any

from steerd.daemon.assembly.build import RunId, RunPlan, make_plan
from steerd.daemon.assembly.session_meta import read_session_car, recorded_path
from steerd.daemon.common.errors import reading
from steerd.daemon.common.screen import watched
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.loop import REQUESTS, Loop
from steerd.daemon.loop.outgoing import make_actuation, read_actuation
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.run_options import decode_options
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.session_read import Record, Session

TOLERANCE = 1e-9  # allowed difference: another machine's libm may differ in the last digits


@dataclass(frozen=True)
class Difference:
    """A tick whose order was not the recorded one: (mode, steer, speed, brake current)."""

    seq: int
    t_ns: int
    recorded: tuple[float, ...]
    replayed: tuple[float, ...]


def make_replay_plan(session: Session, name: str) -> RunPlan:
    """The plan of a recorded run.

    Raises:
        SteerdError: the session was not recorded by `steerd run`.
    """
    meta: dict[str, Any] = dict(session.info().metadata.get("steerd.session", {}))
    with reading(name, "only sessions of `steerd run` hold what a replay needs"):
        options = decode_options(meta["options"])
        run = RunId(int(meta["boot_id"]), int(meta["epoch_ns"]), meta.get("leased") == "1")
        settings = make_settings(read_session_car(session), options.speed)
        with recorded_path(session, options.path) as spec:
            return make_plan(replace(options, path=spec), settings, real=run)


class Replay:
    """A recorded run going through the loop again; `ticks` counts those that were compared."""

    def __init__(self, plan: RunPlan) -> None:
        self.loop = Loop(plan)
        self.ticks = 0
        self._epoch_ns = plan.run.epoch_ns
        seen = self.loop.perception
        self._seen: dict[type, Callable[[Any], None]] = {
            m.MocapPose: seen.on_pose, m.VescTelemetry: seen.on_telemetry, m.VescImu: seen.on_imu,
            m.VescIdentity: self.loop.on_vesc,
        }  # fmt: skip
        self._expected: tuple[int, int, tuple[float, ...]] | None = None

    def take(self, record: Record) -> Difference | None:
        """Feed one recorded message; a difference if there is one."""
        if topics.find_topic(record.topic) is None:
            return None
        message, t_ns = record.decode(), record.log_ns - self._epoch_ns
        if type(message) in self._seen:
            self._seen[type(message)](message)
        elif type(message) in REQUESTS:
            REQUESTS[type(message)](self.loop, message, t_ns)
        elif isinstance(message, m.Tick):
            self._tick(message)
        elif isinstance(message, m.Actuation):
            return self._compare(message)
        return None

    def _tick(self, tick: m.Tick) -> None:
        if not tick.flags & Flag.LINKED:
            self.loop.on_vesc(None)
        result = self.loop.tick(tick.due_ns, tick.woke_ns, tick.flags)
        order = make_actuation(tick.header, result.order.drive, b"", tick.seq)
        self._expected = (tick.seq, tick.woke_ns, read_actuation(order))

    def _compare(self, actuation: m.Actuation) -> Difference | None:
        if self._expected is None or self._expected[0] != actuation.seq:
            return None
        seq, t_ns, replayed = self._expected
        recorded = read_actuation(actuation)
        self.ticks += 1
        if all(map(_same, recorded, replayed)):
            return None
        return Difference(seq, t_ns, recorded, replayed)


def _same(a: float, b: float) -> bool:
    return abs(a - b) <= TOLERANCE or (isnan(a) and isnan(b))


def replay(
    session: Session, name: str, advance: Callable[[int], None] = lambda done: None
) -> tuple[Replay, Iterator[Difference]]:
    """A replay of a session and the differences that it finds as it goes.

    Messages call it `name`; `advance` is called with how many were taken, now and then.

    Raises:
        SteerdError: the session cannot be replayed.
    """
    with reading(name):
        session.check_layouts()
    run = Replay(make_replay_plan(session, name))
    taken = map(run.take, watched(session.messages(), advance))
    return run, (d for d in taken if d is not None)


def describe_difference(difference: Difference, first_ns: int) -> str:
    """One line for people."""

    def order(mode: float, steer: float, speed: float, brake: float) -> str:
        name = m.ActuationMode(int(mode)).name
        return f"{name} steer {steer:+.6f} rad, speed {speed:+.4f} m/s, brake {brake:.1f} A"

    t = (difference.t_ns - first_ns) * 1e-9
    was, now = order(*difference.recorded), order(*difference.replayed)
    return f"tick {difference.seq} ({t:.2f} s): recorded {was}; replayed {now}"
