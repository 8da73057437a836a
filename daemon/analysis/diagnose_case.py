"""What is to be diagnosed, checked: drives, what is held out, the base car, the noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from steerd.car_model.car_file import CarFile, CarFileError, default_car_path, parse_car
from steerd.car_model.effects import find_effect
from steerd.daemon.analysis.diagnose_split import Later, find_moving, split_drives
from steerd.daemon.analysis.drives import (
    Speed,
    Warn,
    is_same,
    load_base,
    load_drives,
    refuse_copies,
    without_reserved,
)
from steerd.daemon.analysis.held_out import HeldOut
from steerd.daemon.assembly.sim_car import compare_truths
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.steer_bus.session_read import SessionError, open_session
from steerd.sysid.data.dataset import Run
from steerd.sysid.estimation.preparation import add_command_history


@dataclass(frozen=True, kw_only=True)
class DiagnoseRequest:
    """What to diagnose; see `diagnose` for what each means.

    Attributes:
        sessions: files of the drives.
        base: the car as believed, or its file; None for the car file inside the session.
        held_out: what the shrinkage is measured on.
        healthy: sessions of the same car without the gap.
        only, without: effects to look at, to leave out.
        pairs: whether two causes together are tried.
        closed_loop: whether a lane drive is driven again in simulation.
        speed: `wheel` takes the measured speed in place of the command.
        jobs: candidates side by side.
    """

    sessions: tuple[Path, ...]
    base: CarFile | Path | None = None
    held_out: HeldOut = field(default_factory=HeldOut)
    healthy: tuple[Path, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    pairs: bool = True
    closed_loop: bool = True
    speed: Speed = "command"
    jobs: int = 1


@dataclass(frozen=True, eq=False)
class Case:
    """A diagnosis to make.

    Attributes:
        sessions: the files whose drives are looked at.
        runs: their drives, cut to where the car moves.
        held_out: opens the drives that are held out; None if none are.
        held_out_of: what is held out, as text.
        healthy: drives without the gap.
        base: the car as believed.
        base_source: where it comes from, as text.
        only, without: effects by their names; `only` None for the library.
        notes: what a reader should know.
    """

    sessions: tuple[Path, ...]
    runs: tuple[Run, ...]
    held_out: Later
    held_out_of: str
    healthy: tuple[Run, ...]
    base: CarFile
    base_source: str
    only: tuple[str, ...] | None
    without: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Driving that is looked at [s]."""
        return sum(run.driven for run in self.runs)


def make_case(request: DiagnoseRequest, warn: Warn, advance: Callable[[float], None]) -> Case:
    """Everything that can be refused is refused here.

    Args:
        request: what to diagnose.
        warn: is handed what is doubtful in the sessions.
        advance: is called with the share of the files read.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    only = tuple(_find_name(name) for name in request.only) or None
    without = tuple(_find_name(name) for name in request.without)
    if only is not None and not set(only) - set(without):
        raise SteerdError("only and without leave no effect", "", ExitCode.USAGE)
    if request.jobs < 1:
        raise SteerdError(f"jobs {request.jobs}: 1 or more", "", ExitCode.USAGE)
    reserved, speed = request.held_out.files, request.speed
    refuse_copies(reserved)
    sessions = without_reserved(request.sessions, reserved, "diagnose")
    _refuse_healthy(request.healthy, (*sessions, *reserved))
    for path in reserved:
        _check_exists(path)
    drives = load_drives(sessions, speed, warn, advance)
    warn(compare_truths({path.name: open_session(path).info().metadata for path in sessions}))
    base, source, notes = find_base(request.base, sessions)
    jitters = dict.fromkeys(" ".join(d.log_jitter.describe()) for d in drives if d.log_jitter)
    drives = add_command_history(drives, base.model, asked=True)
    healthy = load_drives(request.healthy, speed, warn)
    healthy = add_command_history(healthy, base.model, asked=True)
    runs, later, held_out_of, more = split_drives(drives, request.held_out, speed, warn)
    return Case(
        sessions, runs, later, held_out_of, find_moving(healthy) if healthy else (), base, source,
        only, without, (*notes, *jitters, *more),
    )  # fmt: skip


def _find_name(name: str) -> str:
    try:
        return find_effect(name).name
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint or "`steerd effects` lists them", ExitCode.USAGE) from None


def _refuse_healthy(healthy: Sequence[Path], others: Sequence[Path]) -> None:
    """A drive that is to be explained must not count as noise."""
    refuse_copies(healthy)
    for path in healthy:
        if any(is_same(path, each) for each in others):
            what = f"healthy {path} is one of the drives to explain: its gap would pass for noise"
            raise SteerdError(what, "name a drive without the gap", ExitCode.USAGE)


def _check_exists(path: Path) -> None:
    """A held-out session is not opened yet, but its absence is reported at once."""
    if not path.is_file():
        raise SteerdError(f"{path} does not exist", "", ExitCode.UNREADABLE)


def find_base(
    named: CarFile | Path | None, sessions: Sequence[Path]
) -> tuple[CarFile, str, list[str]]:
    """The car or car file named, else the one inside the first session, else the default.

    Returns:
        The car, where it comes from, notes.

    Raises:
        SteerdError: the one that counts cannot be used.
    """
    if isinstance(named, CarFile):
        return named, str(named.path), []
    if named is not None:
        return load_base(named), str(named), []
    texts = [text for text in map(_embedded, sessions) if text is not None]
    if not texts:
        note = "no --base, no car file in the sessions: the default car is assumed"
        return load_base(default_car_path()), "the default car (F1TENTH's figures)", [note]
    notes = []
    if any(text != texts[0] for text in texts) or len(texts) < len(sessions):
        notes.append(f"the sessions' car files differ: the one inside {sessions[0].name} counts")
    try:
        base = parse_car(texts[0], Path("car.toml"))
    except CarFileError as error:
        what = f"{sessions[0].name}: the car file inside cannot be used: {error.what}"
        raise SteerdError(what, "name one with --base car.toml", ExitCode.INVALID) from None
    return base, "the car file inside the session", notes


def _embedded(path: Path) -> str | None:
    """The car file that a session carries; None if there is none."""
    try:
        return open_session(path).attachment("car.toml").decode()
    except (SessionError, UnicodeDecodeError):
        return None
