"""A recorded lane drive driven again in simulation, without and with the effect that was found.

Path, speed, rate, controller and filter settings are the session's own; only the simulated car is
exchanged. The noise of the simulated hardware is another than that of a simulated recording.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from steerd.car_model.car_file import CarFile, CarFileError
from steerd.car_model.effects import EFFECTS
from steerd.car_model.model import Model
from steerd.car_model.state import ORIGIN, State
from steerd.daemon.assembly.build import RunPlan, make_plan, make_world_config
from steerd.daemon.assembly.session_meta import csv_file, read_session_car, recorded_path
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import drive, make_virtual_run
from steerd.daemon.sessions.motion import SETTLE
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.run_options import ControllerKind, RunOptions, recorded_options
from steerd.sim_gap.lane_comparison import SHORTEST, LaneComparison, LaneDrive
from steerd.sim_hw.world import World
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.session_read import Session, SessionError
from steerd.steer_bus.topics import find_topic

SECONDS = 20.0  # length of a simulated drive: several bends; longer adds nothing to a profile [s]
_SEED = 7919  # added to the recorded seed: a simulated recording must not get its own noise again

Rows = NDArray[np.float64]
Values = Mapping[str, tuple[float, ...]]


def compare_lane(session: Session, base: CarFile, found: Values) -> LaneComparison:
    """Drive a session's lane again, on the base car and with the effects that were found on it.

    A SteerdError says why there is no lane drive that can be driven again.
    """
    options, name = _options_of(session), session.info().path.name
    try:
        settings = make_settings(read_session_car(session), options.speed)
    except (SessionError, CarFileError) as error:
        raise SteerdError(f"its car file cannot be used ({error})") from None
    settings = replace(settings, brakes=replace(settings.brakes, uuid=""))
    try:  # the file that its path names comes from the session itself
        with recorded_path(session, options.path) as path:
            plan = make_plan(replace(options, path=path), settings)
    except SessionError:
        raise SteerdError("its path file is not in the session") from None
    for topic in session.info().topics:
        if find_topic(topic.name) is topics.PARAMETERS:
            said = [record.decode() for record in session.messages(topic.name)]
            if len({(p.speed, p.offset, p.gain) for p in said}) > 1:
                # Simulated, it would be another drive.
                raise SteerdError("its live parameters were changed while it drove")
    rows = _recorded(session)
    recorded = _lane_drive(rows[:, :5], plan)
    if recorded is None:
        raise SteerdError(f"it keeps the lane for less than {SETTLE + SHORTEST:g} s")
    x, y, yaw = (float(v) for v in rows[0, 5:])
    start = ORIGIN._replace(x=x, y=y, yaw=yaw)
    remarks: list[str] = []
    without = _simulated(plan, base, {}, start, remarks)
    other = _simulated(plan, base, found, start, remarks) if found else None
    # Options of `steerd run` for the same lane; none of a path file that is no longer there.
    file = csv_file(options.path)
    known = options.path == RunOptions.path or (file and not Path(file).is_file())
    again = f"{'' if known else f'--path {shlex.quote(options.path)} '}--speed {options.speed:g}"
    return LaneComparison(recorded, without, other, name, again, tuple(remarks))


def _options_of(session: Session) -> RunOptions:
    """How the session was driven, as a simulation of the same length at most."""
    options = recorded_options(session.info().metadata)
    if options is None:
        raise SteerdError("it was not recorded by `steerd run`")
    if options.drill:
        raise SteerdError("it was driven by an excitation plan, not by the lane keeper")
    if options.controller is not ControllerKind.LANE:
        raise SteerdError("another program steered")
    return replace(
        options, car_file="", port=None, mocap=None, simulated=True, auto_arm=True, effects=(),
        sim_car="", duration_s=SECONDS, seed=options.seed + _SEED, record=None,
    )  # fmt: skip


def _recorded(session: Session) -> Rows:
    """Rows t, s, e1, e2, steer, x, y, yaw while the car was driven."""
    try:
        table = session.columns(topics.STATE.message)
    except SessionError:
        raise SteerdError("it holds no lane errors") from None
    t = (table["stamp_ns"] - table["stamp_ns"][:1]).astype(float) * 1e-9
    names = ("path_s", "e1", "e2", "steer_ref", "x", "y", "yaw")
    rows: Rows = np.column_stack([t, *(table[name].astype(float) for name in names)])
    rows = rows[(table["mode"] == SupervisorState.RUNNING) & np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise SteerdError("it was never driven")
    return rows


def _lane_drive(rows: Rows, plan: RunPlan) -> LaneDrive | None:
    """The settled part of rows t, s, e1, e2, steer; None where it is too short."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[rows[:, 0] >= rows[0, 0] + SETTLE] if len(rows) else rows
    if len(rows) < 2 or np.ptp(rows[:, 0]) < SHORTEST:
        return None
    t, s, e1, e2, steer = rows.T
    return LaneDrive(t, s, e1, e2, steer, float(plan.path.length))


def _simulated(
    plan: RunPlan, base: CarFile, found: Values, start: State[float], remarks: list[str]
) -> LaneDrive | None:
    """The plan driven by its controller on a car; None, and a remark, if it does not last."""
    label = "with the effect" if found else "without the effect"
    own = dict(zip((e.name for e in base.effects), base.values, strict=True)) | dict(found)
    effects = tuple(EFFECTS[name] for name in own)
    model = Model(base.car, effects, tuple(own.values()), base.chassis)
    config = replace(make_world_config(plan), model=model, start=start)
    rows: list[tuple[float, ...]] = []

    def sink(records: list[PipeRecord], t_ns: int) -> None:
        for each in records:
            if each.topic is topics.STATE:
                now = decode(topics.STATE.message, each.data)
                if now.mode == SupervisorState.RUNNING:
                    rows.append((t_ns * 1e-9, now.path_s, now.e1, now.e2, now.steer_ref))

    run = make_virtual_run(plan, (sink,), World(config))
    drive(run)
    if run.core.loop.faulted:
        remarks.append(f"{label} the simulation is stopped: {run.core.loop.fault}")
    driven = _lane_drive(np.array(rows).reshape(-1, 5), plan)
    if driven is None:
        remarks.append(f"{label} the simulated car does not stay in its lane")
    return driven


def try_lane(
    sessions: Sequence[Session], base: CarFile, found: Values
) -> tuple[LaneComparison | None, str]:
    """The comparison on the first lane drive, or None and why there is none."""
    why = ""
    for session in sessions:
        name = session.info().path.name
        try:
            return compare_lane(session, base, found), ""
        except SteerdError as error:
            why = why or f"closed loop not compared: {name}: {error.what}"
    return None, why
