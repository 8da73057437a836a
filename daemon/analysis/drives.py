"""Sessions as drives for the offline tools, each opened once; what cannot be used is one line.

Commands that a result names run as they are printed: what lies below knows no session and says
`steerd collect --plan steps`; a session knows where it came from, so the command gets its
simulation, or its port and mocap.
"""

# Why: docs/decisions/identification.md#d107

import filecmp
import re
import resource
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

from numpy.linalg import LinAlgError

from steerd.daemon.analysis.options import EVERY, HeldOut, Speed, Watch
from steerd.daemon.assembly.sim_car import read_origin
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, reading
from steerd.daemon.sessions.info import load_session, make_session_report, read_recording
from steerd.daemon.sessions.motion import check_steering
from steerd.sim_gap.diagnosis import Case
from steerd.steer_bus.atomic_file import takes_nothing
from steerd.steer_bus.session_read import Session
from steerd.sysid.data import segments
from steerd.sysid.data.data_checks import DataError
from steerd.sysid.data.dataset import Run, read_run
from steerd.sysid.data.jitter_correction import correct_log_jitter
from steerd.sysid.estimation.preparation import HISTORY

MOST = 1200.0
"""Driving that is looked at, at most [s]: ten times what identifies a car to a percent or two, and
what a diagnosis judges in minutes; time and memory of either would grow with the rest."""

FILES = 500  # sessions that stay open within a shell's usual limit of 1024 files
_DRIVEN = re.compile(r"`(steerd (collect|run) [^`]*)`")


@dataclass(frozen=True, eq=False)
class Drives:
    """Open sessions, and what of them is looked at."""

    sessions: tuple[Session, ...]  # each opened once
    runs: tuple[Run, ...]  # their drives; of long ones pieces, evenly from the whole

    def __repr__(self) -> str:
        return f"<Drives of {', '.join(path.name for path in self.paths)}>"

    @property
    def paths(self) -> tuple[Path, ...]:
        """The sessions' files."""
        return tuple(session.info().path for session in self.sessions)

    @property
    def metadata(self) -> dict[str, Mapping[str, Mapping[str, str]]]:
        """What the recorders say, by file."""
        return {s.info().path.name: s.info().metadata for s in self.sessions}

    @property
    def names(self) -> str:
        """Their files as words of a command line."""
        return " ".join(shlex.quote(str(path)) for path in self.paths)

    def complete(self, text: str) -> str:
        """The text with commands, between backticks, that run as printed for these sessions.

        The first says which car drives. The log of another system does not: it is sent to the
        description of the plans.
        """
        text = text.replace("`steerd identify`", f"`steerd identify {self.names} -o car.toml`")
        text = text.replace("`steerd diagnose`", f"`steerd diagnose {self.names}`")
        origin = read_origin(self.sessions[0].info().metadata)
        if origin:
            end = {"run": " --duration 20"} if origin.startswith("--sim") else {}
            return _DRIVEN.sub(lambda f: f"`{f[1]} {origin}{end.get(f[2], '')}`", text)
        return _DRIVEN.sub("see `steerd collect --help`", text)

    def simulate_with(self, car: Path, more: str = "") -> str:
        """The command that drives with a car file what was driven before, in simulation.

        Where the sessions are simulated, their car is what drives; `more` are further options.
        """
        origin = read_origin(self.sessions[0].info().metadata, own_car=False)
        origin = origin if origin.startswith("--sim") else "--sim --fast"
        return f"steerd run {origin} --duration 20 --car {shlex.quote(str(car))}{more}"

    @contextmanager
    def refusing(self, stopped: str = "") -> Iterator[None]:
        """The one guard around what works on drives: what they are not fit for is one line.

        `stopped` is what to try where the simulation of the car diverges. The hint of the
        SteerdError runs as printed.
        """
        try:
            yield
        except DataError as error:
            raise SteerdError(error.what, self.complete(error.hint)) from None
        except ModuleNotFoundError:
            raise
        except ImportError as error:  # says which optional extra is missing
            raise UsageError(str(error)) from None
        except FloatingPointError as error:
            raise SteerdError(str(error), stopped, ExitCode.STOPPED) from None
        except LinAlgError:
            what = "the base car's simulation leaves every bound in some of these windows"
            raise SteerdError(what, stopped, ExitCode.STOPPED) from None
        except (ValueError, OSError) as error:
            if takes_nothing(error):
                raise
            raise SteerdError(str(error)) from None


def load_drive(path: Path, speed: Speed, watch: Watch) -> tuple[Session, Run]:
    """A session and its drive.

    Raises:
        SteerdError: it cannot be read, or is not fit for a fit.
    """
    session = load_session(path)
    damage = session.info().warnings
    watch.warn([f"{path.name}: {each}" for each in damage])
    with Drives((session,), ()).refusing():
        with reading(path):
            read = read_recording(session)
            run = correct_log_jitter(read_run(session, read.tables))
        if what := check_steering(run.commands[:, 0]):  # a fit would absorb degrees
            hint = "import it with scale = 0.0174532925 in the map"
            raise SteerdError(f"{run.name}: {what}", hint)
        report = make_session_report(read)
        watch.warn([f"{path.name}: {each}" for each in report.warnings if each not in damage])
        return session, segments.with_wheel_speed(run) if speed == "wheel" else run


def load_drives(
    paths: Sequence[Path],
    speed: Speed,
    watch: Watch,
    advance: Callable[[float], None] = lambda _: None,
) -> Drives:
    """Sessions as drives, one after the other, see `load_drive`.

    `advance` hears the share of the files read.
    """
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    if len(paths) > FILES:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    sessions: list[Session] = []
    found: list[Run] = []
    whole, cut = 0.0, False
    for number, path in enumerate(paths):
        session, run = load_drive(path, speed, watch)
        parts = segments.spread_evenly(run, max(MOST / len(paths), segments.PIECE), HISTORY)
        cut |= parts[0] is not run
        sessions.append(session)
        found += parts
        whole += run.driven
        advance((number + 1) / len(paths))
    kept = segments.thinned(found, MOST)
    if cut or len(kept) < len(found):
        used = sum(run.driven for run in kept) / 60.0
        what = f"of {whole / 3600.0:.1f} h {used:.0f} min are used"
        watch.warn([f"{what}, in pieces of {segments.PIECE:g} s, evenly from all sessions"])
    return Drives(tuple(sessions), tuple(kept))


def is_same(one: Path, other: Path) -> bool:
    """Whether two names mean one session: the same file, or a copy of it."""
    try:
        return one.resolve() == other.resolve() or filecmp.cmp(one, other, shallow=False)
    except OSError:
        return False  # whoever reads it says why it cannot be read


def refuse_copies(paths: Sequence[Path]) -> None:
    """A drive that counts twice passes for more data than there are.

    Raises:
        SteerdError: one drive is named twice.
    """
    for one, other in combinations(paths, 2):
        if is_same(one, other):
            copy = f"{other} is a copy of {one}" if one != other else f"{one} is named twice"
            raise UsageError(copy, "name each drive once")


def without_reserved(
    given: Sequence[Path], reserved: Sequence[Path], purpose: str, healthy: Sequence[Path] = ()
) -> tuple[Path, ...]:
    """The sessions that are not held out: of `*.mcap` those that no other option names.

    Raises:
        SteerdError: one drive is named twice, or none is left for the `purpose`.
    """
    for paths in (reserved, given, healthy):
        refuse_copies(paths)
    kept = tuple(path for path in given if not any(is_same(path, each) for each in reserved))
    if not kept:
        what = f"every session is held out: nothing is left to {purpose}"
        raise UsageError(what, "name another session")
    for path in healthy:
        if any(is_same(path, each) for each in (*kept, *reserved)):
            what = f"healthy {path} is one of the drives to explain: its gap would pass for noise"
            raise UsageError(what, "name a drive without the gap")
    return kept


# -- what of a diagnosis's drives is explained, and what measures the shrinkage --------------------

BLOCK = 6.5  # least length of a block: it holds two separate predictions 3 s ahead [s]
_OVER = 0.45  # a block may be so much longer than whole seconds; more is one window more [s]
FEWEST = 3  # of fewer blocks none is held out unless it is asked for
LEAST = 5.0  # a gap is not identifiable from less driving than this [s]


def split_drives(case: Case, held_out: HeldOut, speed: Speed, watch: Watch) -> Case:
    """The case with its drives cut to where the car moves, some to explain, some held out.

    Those that are held out measure the shrinkage; whole sessions are opened later.

    Raises:
        DataError: there is too little driving.
        SteerdError: there is too little to hold so much out.
    """
    drives, every = case.runs, held_out.every
    parts = segments.moving_segments(drives)
    seconds = sum(run.driven for run in parts)
    if seconds < LEAST:
        what = f"only {seconds:.1f} s of driving at more than walking pace"
        raise DataError(what, "drive `steerd collect --plan mixed`")
    # Of long sessions there are several drives. Few drives are cut, so that parts of them can be
    # left out of fits.
    sessions, few = list(dict.fromkeys(run.name for run in drives)), len(drives) < EVERY
    notes = segments.describe_unused(drives)
    if few:
        count = "one session" if len(sessions) == 1 else f"{len(sessions)} sessions"
        note = f"{count}, cut into blocks of {BLOCK:g} s or more: they stand in for further drives"
        notes = (note, *notes)
    case = replace(case, notes=(*case.notes, *notes))
    cut = partial(segments.make_blocks, length=BLOCK, count=int, over=_OVER)
    blocks = cut(parts)
    if held_out.files:
        past = drives[0].history

        def later() -> Sequence[Run]:
            opened = load_drives(held_out.files, speed, watch)
            return segments.moving_segments([replace(drive, history=past) for drive in opened.runs])

        names = ", ".join(path.name for path in held_out.files)
        return replace(case, runs=blocks if few else parts, later=later, held_out_of=names)
    number = every or EVERY
    out = sessions[number - 1 :: number]
    whole = tuple(run for run in parts if run.name in out)
    fitted = tuple(run for run in parts if run.name not in out)
    if every != 0 and whole and fitted:
        named = f"every {_ordinal(number)} session: {', '.join(sorted(out))}"
        runs = cut(fitted) if few else fitted
        return replace(case, runs=runs, later=lambda: whole, held_out_of=named)
    if every is None:
        every = min(EVERY, len(blocks)) if len(blocks) >= FEWEST else 0
    if every == 0:
        note = "nothing is held out: the shrinkage is predicted, not measured"
        return replace(case, runs=blocks if few else parts, notes=(*case.notes, note))
    if len(blocks) < every:
        what = f"only {len(blocks)} blocks: too few to hold every {_ordinal(every)} out"
        raise SteerdError(what, "--held-out 0, or name a session")
    fitted, kept = segments.split_every(blocks, every)
    named = f"every {_ordinal(every)} block of the drive"
    return replace(case, runs=fitted, later=lambda: kept, held_out_of=named)


def _ordinal(number: int) -> str:
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ends.get(number % 10, 'th')}"
