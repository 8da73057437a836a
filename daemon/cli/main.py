"""The `steerd` command: finds the subcommand and loads only that one.

Nothing here imports NumPy or torch, so `steerd --help` takes 30 ms.
"""

# Why: docs/decisions/processes-and-time.md#d21
# Why: docs/decisions/rooms-and-code.md#d22

import argparse
import contextlib
import errno
import importlib
import inspect
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple, TextIO

from steerd.daemon.cli.arguments import check_inputs
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, did_you_mean
from steerd.daemon.common.screen import prepare_streams, print_labelled
from steerd.version import VERSION

# OpenBLAS's threads slow small matrices down: a controller design took 3 s instead of 0.05 s.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "drive": {
        "run": ("run", "drive: the control loop on a car or on simulated hardware"),
        "start": ("operate", "drive an armed car; it stops when this terminal is closed"),
        "stop": ("operate", "stop a driving car"),
        "estop": ("operate", "emergency stop"),
        "arm": ("operate", "arm a running daemon"),
        "disarm": ("operate", "disarm a running daemon"),
        "clear": ("operate", "acknowledge a latched fault"),
        "status": ("operate", "state of a running daemon and what it is waiting for"),
        "watch": ("remote", "a running car in the terminal: state, errors, rates, faults"),
        "page": ("remote", "a running car as a live page in a browser, with a stop button"),
        "teleop": ("remote", "drive by gamepad, with a deadman's button"),
        "control": ("remote", "the lane keeper as a process of its own, over zenoh"),
        "collect": ("run", "drive an excitation plan and record it"),
    },
    "sessions": {
        "sessions": ("sessions", "the recorded drives: date, car, errors, notes"),
        "info": ("sessions", "contents of a session"),
        "plot": ("sessions", "a drive as one HTML page: track, errors, commands, timing"),
        "replay": ("sessions", "feed a recorded session through the loop and compare its commands"),
        "recover": ("sessions", "rebuild the session of a recorder that was killed"),
        "import": ("import_", "turn a lab's own log (csv, ROS bag) into a session"),
    },
    "learn": {
        "identify": ("learning", "learn the car from its sessions"),
        "diagnose": (
            "learning",
            "where simulation and car differ, why, and how far adding it helps",
        ),
        "learn": ("learning", "the parameters that a drive identifies, and when the car changed"),
        "effects": ("car_files", "the unmodelled effects that can be simulated and diagnosed"),
        "sweep": ("many", "many drives in virtual time, each another draw of the car"),
        "batch": ("many", "hundreds of sessions: each a row; what changed, and since when"),
    },
    "set up": {
        "setup": ("setup", "from a car that nobody measured to its car file, step by step"),
        "probe": ("probe", "find VESCs and mocap servers, and what is wrong with them"),
        "config": ("car_files", "print a commented car file, check one, convert F1TENTH's gains"),
        "export": ("car_files", "a car file for f1tenth_gym or MuJoCo"),
        "mocap": ("calibrate", "check mocap; calibrate the place of its body on the car"),
        "calibrate": ("calibrate", "centre, gain and limits of the steering"),
        "sim": ("remote", "simulated hardware alone: a VESC on a pty, a mocap server"),
        "rtcheck": ("probe", "measure whether this machine can run a control loop on time"),
        "completion": ("completion", "completion scripts for bash, zsh, tcsh and fish"),
    },
    "lab": {
        "keys": ("keys", "certificates of a lab: for the car, its operators, its viewers"),
        "service": ("service", "a systemd unit that starts disarmed, and the udev file"),
    },
}
"""Commands by what they are for: module below `commands` and one line of help, by name."""
COMMANDS = {name: row for group in GROUPS.values() for name, row in group.items()}
_FUNCTIONS = dict.fromkeys(("start", "stop", "estop", "arm", "disarm", "clear"), "operate")
_FUNCTIONS["import"] = "import_log"  # functions that are not called as their command


class Command(NamedTuple):
    """A command, as its module declares it by two functions."""

    run: Callable[[argparse.Namespace], int | None]  # its docstring is the help text
    add_arguments: Callable[[argparse.ArgumentParser], None]
    first: Sequence[str]  # options that `--help` shows; all where none is named


ABOUT = "Control, identification and sim-to-real diagnosis for Ackermann cars."


def find_command(name: str) -> Command:
    """A command by its name; no other module is loaded."""
    module = importlib.import_module(f"steerd.daemon.cli.commands.{COMMANDS[name][0]}")
    function = _FUNCTIONS.get(name, name)
    run, add_arguments = getattr(module, function), getattr(module, f"{function}_arguments")
    return Command(run, add_arguments, getattr(module, "FIRST_OPTIONS", {}).get(name, ()))


def list_commands() -> str:
    """The text of `steerd --help`."""
    head = f"usage: steerd COMMAND ...\n\n{ABOUT}\n\noptions:\n"
    parts = [f"{head}  -h, --help  show this help message and exit"]
    for title, group in GROUPS.items():
        rows = (f"  {name:<12}{text}" for name, (_, text) in group.items())
        parts.append("\n".join((title, *rows)))
    return "\n\n".join((*parts, "`steerd COMMAND --help` explains one of them."))


def dispatch(argv: Sequence[str]) -> int:
    """Run one command line and give its exit code; errors pass through."""
    name, rest = argv[0] if argv else "--help", argv[1:]
    if name in ("-h", "--help", "--version"):
        print(f"steerd {VERSION}" if name == "--version" else list_commands())
        raise SystemExit(0)
    if name not in COMMANDS:
        hint = did_you_mean(name, COMMANDS) or "`steerd --help` lists the commands"
        raise UsageError(f"there is no command {name!r}", hint)
    command = find_command(name)
    parser = argparse.ArgumentParser(
        prog=f"steerd {name}",
        description=inspect.cleandoc(command.run.__doc__ or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        exit_on_error=False,
    )
    command.add_arguments(parser)
    parser.set_defaults(command=name)
    if {"-h", "--help", "--help-all"} & set(rest):
        _explain(parser, () if "--help-all" in rest else command.first)
        rest = ["--help" if word == "--help-all" else word for word in rest]
    try:
        args, unknown = parser.parse_known_args(rest)
    except argparse.ArgumentError as error:
        raise _unusable(name, error) from None
    if unknown:
        raise _refuse(name, parser, unknown)
    check_inputs(parser, args)
    return command.run(args) or ExitCode.OK


def _explain(parser: argparse.ArgumentParser, first: Sequence[str]) -> None:
    """Say what options' defaults are, and leave only the first ones where a command says which."""
    options = [a for a in parser._actions if a.option_strings and a.dest != "help"]  # noqa: SLF001
    rest = [a for a in options if first and not set(a.option_strings) & set(first)]
    for action in options:
        if action.default not in (None, False, "", []) and "default" not in (action.help or ""):
            action.help = f"{action.help} (default: %(default)s)"
    for action in rest:
        action.help = argparse.SUPPRESS
    if rest:
        parser.epilog = f"`{parser.prog} --help-all` shows {len(rest)} more options."


def _unusable(name: str, error: argparse.ArgumentError) -> SteerdError:
    comma = re.search(r"'(-?\d+),(\d+)'", error.message)
    hint = f"{comma[1]}.{comma[2]}" if comma else f"`steerd {name} --help` shows its options"
    what = error.message.replace("invalid float value", "not a number")
    what = what.replace("invalid int value", "not a whole number")
    return SteerdError(f"{error.argument_name}: {what}", hint, ExitCode.USAGE)


def _refuse(name: str, parser: argparse.ArgumentParser, unknown: list[str]) -> SteerdError:
    """The error of words that a command does not take, with the nearest option."""
    options = [text for action in parser._actions for text in action.option_strings]  # noqa: SLF001
    word = next((each for each in unknown if each.startswith("-")), unknown[0])
    what = f"`steerd {name}` takes no {word.partition('=')[0]}"
    hint = did_you_mean(word.partition("=")[0], options) if word.startswith("-") else ""
    return SteerdError(what, hint or f"`steerd {name} --help` shows its options", ExitCode.USAGE)


def main() -> int:
    """Entry point of the console script."""
    prepare_streams()
    warnings.showwarning = show_warning
    code = run_cli(sys.argv[1:])
    if "zenoh" in sys.modules:
        # zenoh's threads may call into Python while the interpreter shuts down, which aborts.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def run_cli(argv: Sequence[str]) -> int:
    """Run one command line; a failure is a line or two on standard error and an exit code."""
    try:
        code = dispatch(argv)
        sys.stdout.flush()
        return code
    except SteerdError as error:
        return _report(error)
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.OK
    except Exception as error:
        known = _find_cause(argv[0], error)
        if known is not None:
            return _report(known)
        traceback.print_exc()
        print("steerd: this is a bug in steerd; please report the lines above", file=sys.stderr)
        return ExitCode.INTERNAL


def _find_cause(name: str, error: Exception) -> SteerdError | None:
    """What a machine lacks, a package, room on its disk or the compiled equations; else None."""
    from steerd.steer_bus.atomic_file import is_full, takes_nothing

    if isinstance(error, ModuleNotFoundError) and not str(error.name).startswith("steerd"):
        what = f"`steerd {name}` needs {error.name}, which a car's computer does without"
        hint = "pip install -c constraints.txt -e . (in the checkout)"
        return SteerdError(what, hint, ExitCode.USAGE)
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        hint = "raise the limit: `ulimit -n 1024`"
        return SteerdError(f"{error.strerror}", hint, ExitCode.UNREADABLE)
    if isinstance(error, OSError) and takes_nothing(error):
        # What is buffered has no place to go, at the end too.
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        where = error.filename or "a cache, a temporary file or the output"
        hint = "look at its owner, its rights and its mount"
        hint = "free some space" if is_full(error) else hint
        return SteerdError(f"{where}: {error.strerror}", hint, ExitCode.UNREADABLE)
    if type(error).__name__ == "LibraryError":  # which a command that computes has loaded
        return SteerdError(str(error), "", ExitCode.UNREADABLE)
    return None


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Show steerd's own warnings as its errors are shown; others with their place in the code."""
    stream = file or sys.stderr
    if category.__module__.startswith("steerd."):
        print_labelled("steerd: ", str(message), stream)
    else:
        stream.write(warnings.formatwarning(message, category, filename, lineno, line))


def _report(error: SteerdError) -> ExitCode:
    """Say what happened and what to try; the exit code."""
    print_labelled("steerd: ", error.what, sys.stderr)
    if error.hint:
        print_labelled("   try: ", error.hint, sys.stderr)
    return error.code


if __name__ == "__main__":
    raise SystemExit(main())
