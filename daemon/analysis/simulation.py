"""`steerd.simulate`: a drive of the control loop on a simulated car, in virtual time."""

import warnings
import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from steerd.daemon.analysis.options import CarSource, read_car
from steerd.daemon.analysis.recorded import Session
from steerd.daemon.assembly.build import VIRTUAL_EPOCH_NS, RunPlan, make_plan
from steerd.daemon.common.errors import UsageError
from steerd.daemon.common.notebook import speaking_of_arguments
from steerd.daemon.ipc.pipe_records import PipeRecord, read_message
from steerd.daemon.offline.fast import check_driven, record_virtual
from steerd.daemon.offline.virtual import VirtualRun, drive
from steerd.daemon.process.external_controller import Controller, ExternalController, while_driving
from steerd.daemon.sessions.info import load_session
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.run_options import ControllerKind, RunOptions
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import StateMessage

DURATION_MAX = 86_400.0  # a day [s]
EffectValues = Mapping[str, float | Sequence[float] | Mapping[str, float]]
"""Parameters by effect: one value, all in order, or some by their names; see `steerd effects`."""


@speaking_of_arguments
def simulate(
    car: CarSource = None,
    path: str = "figure8",
    *,
    speed: float = 1.0,
    duration: float = 20.0,
    seed: int = 0,
    effects: EffectValues | None = None,
    record: Path | str | None = None,
    controller: Controller | None = None,
) -> Session:
    """Drive a simulated car around a path in virtual time; the same arguments give the same drive.

    Args:
        car: a car file, an `Identification`, a `Diagnosis`; None for the F1TENTH car.
        path: `line`, `circle:radius=2`, `figure8`, `csv:FILE` (TUM or F1TENTH centreline).
        speed: on straights [m/s].
        duration: of the drive [s].
        seed: of the simulated hardware's noise.
        effects: unmodelled effects of the simulated car, as in `{"steer_delay": 0.05}`; the
            controller knows nothing of them.
        record: where the session file lies; None for a temporary file that goes with the value.
        controller: a function of one's own, from time [s], `State` and `Lane` to the command
            (steer [rad], speed [m/s]), called with every estimate while the car drives, within
            the car's limits and watchdogs; None for the lane keeper. `steerd.serve` is the same
            for a car.

    Returns:
        The recorded drive. A `UserWarning` says so where a watchdog stopped it early.

    Raises:
        SteerdError: an argument cannot be used, or the car was never driven.
    """
    plan = plan_drive(car, path, speed, duration, seed, effects, external=controller is not None)
    if record is not None:
        return _record(plan, Path(record), controller)
    with ExitStack() as stack:
        folder = TemporaryDirectory(prefix="steerd-", ignore_cleanup_errors=True)
        session = _record(plan, Path(stack.enter_context(folder), "simulated.mcap"), controller)
        weakref.finalize(session, stack.pop_all().close)  # from here on the file is the session's
    return session


def plan_drive(
    car: CarSource,
    path: str,
    speed: float,
    duration: float,
    seed: int,
    effects: EffectValues | None,
    *,
    external: bool = False,
    rate: float = RunOptions.rate_hz,
) -> RunPlan:
    """A drive as `simulate` describes it; `external`: a function drives, not the lane keeper."""
    if not 0.0 < duration <= DURATION_MAX:
        raise UsageError(f"duration {duration:g}: more than 0 s, {DURATION_MAX:g} s at most")
    if not 0.0 < speed < float("inf"):
        raise UsageError(f"speed {speed:g}: more than 0 m/s")
    if seed < 0:
        raise UsageError(f"seed {seed}: 0 or more")
    options = RunOptions(
        car_file="", path=path, speed=speed, duration_s=duration, seed=seed, simulated=True,
        rate_hz=rate, auto_arm=True,
        effects=tuple(_format_effect(*each) for each in (effects or {}).items()),
        controller=ControllerKind.ZENOH if external else ControllerKind.LANE,
    )  # fmt: skip
    return make_plan(options, make_settings(read_car(car), speed))


def _record(plan: RunPlan, file: Path, controller: Controller | None) -> Session:
    if controller is None:
        run = record_virtual(plan, file, drive)
    else:
        steered = Steered(controller, plan.run.boot_id)
        run = record_virtual(plan, file, lambda run: drive(run, steered.command), steered.see)
    check_driven(run)
    if run.core.loop.faulted:
        warnings.warn(f"the drive was stopped: {run.core.loop.fault}", stacklevel=4)
    return Session(file, load_session(file))


class Steered:
    """A controller beside the loop in virtual time, which the bus would lie between."""

    def __init__(self, controller: Controller, boot_id: int) -> None:
        self._made = ExternalController(while_driving(controller), boot_id, lease_id=1)
        self._answered: StateMessage | None = None
        self.newest: StateMessage | None = None  # the last estimate; None before the first

    def see(self, records: list[PipeRecord], t_ns: int) -> None:
        """What the core sent."""
        for record in records:
            if record.topic is topics.STATE:
                self.newest = read_message(record)

    def command(self, run: VirtualRun) -> None:
        """Answer the newest estimate, once."""
        if self.newest is None or self.newest is self._answered:
            return
        self._answered = self.newest
        command = self._made.compute_command(self.newest, VIRTUAL_EPOCH_NS + run.t_ns)
        if command is not None:
            run.core.on_request(topics.DRIVE.name, encode(command), run.t_ns)


def _format_effect(name: str, values: float | Sequence[float] | Mapping[str, float]) -> str:
    if isinstance(values, Mapping):
        return f"{name}:{','.join(f'{key}={float(value)!r}' for key, value in values.items())}"
    numbers = (values,) if isinstance(values, int | float) else tuple(values)
    return f"{name}={','.join(repr(float(value)) for value in numbers)}"
