"""Commands that a result names, made such that they run as they are printed.

What lies below knows no session: it says `steerd collect --plan steps`. A session knows where it
came from, so the command gets its simulation, or its port and mocap.
"""

import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from numpy.linalg import LinAlgError

from steerd.daemon.assembly.sim_car import read_origin
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.steer_bus.atomic_file import takes_nothing
from steerd.steer_bus.session_read import Session
from steerd.sysid.data.data_checks import DataError

_DRIVEN = re.compile(r"`(steerd (collect|run) [^`]*)`")


def complete(text: str, sessions: Sequence[Session]) -> str:
    """The text with commands, between backticks, that run as printed for these sessions.

    The first says which car drives. The log of another system does not: it is sent to the
    description of the plans.
    """
    names = name_all([session.info().path for session in sessions])
    text = text.replace("`steerd identify`", f"`steerd identify {names} -o car.toml`")
    text = text.replace("`steerd diagnose`", f"`steerd diagnose {names}`")
    origin = read_origin(sessions[0].info().metadata)
    if origin:
        end = {"run": " --duration 20"} if origin.startswith("--sim") else {}
        return _DRIVEN.sub(lambda f: f"`{f[1]} {origin}{end.get(f[2], '')}`", text)
    return _DRIVEN.sub("see `steerd collect --help`", text)


def name_all(paths: Sequence[Path]) -> str:
    """Files as words of a command line."""
    return " ".join(shlex.quote(str(path)) for path in paths)


def simulate_with(car: Path, sessions: Sequence[Session], more: str = "") -> str:
    """The command that drives with a car file what was driven before, in simulation.

    Where the sessions are simulated, their car is what drives; `more` are further options.
    """
    origin = read_origin(sessions[0].info().metadata, own_car=False)
    origin = origin if origin.startswith("--sim") else "--sim --fast"
    return f"steerd run {origin} --duration 20 --car {shlex.quote(str(car))}{more}"


@contextmanager
def refusing(sessions: Sequence[Session], stopped: str = "") -> Iterator[None]:
    """The one guard around what works on drives: what they are not fit for is one line.

    `stopped` is what to try where the simulation of the car diverges.

    Raises:
        SteerdError: with a hint that runs as printed.
    """
    try:
        yield
    except DataError as error:
        raise SteerdError(error.what, complete(error.hint, sessions)) from None
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
