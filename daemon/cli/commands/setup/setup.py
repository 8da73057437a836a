"""From a car that nobody has measured to its identified car file, step by step.

steerd setup --port /dev/ttyACM0 --mocap natnet://HOST/car

Each step is a command of steerd: its line is shown, runs on Enter, and prints
what it measured with its error. A step can be repeated, skipped, or run by
hand. Nothing moves before you arm and start it with the keys that `run` shows.
"""

import argparse
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError

_KEYS = "[Enter] do it   [s] skip   [b] back   [q] quit: "


class Step(NamedTuple):
    """One step.

    Attributes:
        title: what it finds out.
        before: what to do before it, and what to look at.
        words: the command's arguments after `steerd`.
        makes: the file that the command's standard output goes to; None for the terminal.
    """

    title: str
    before: str
    words: tuple[str, ...]
    makes: Path | None = None


def list_steps(port: str, mocap: str, folder: Path) -> tuple[Step, ...]:
    """What is done for a car, in order; files lie in the folder."""
    car, slow, mixed = folder / "car.toml", folder / "slow.mcap", folder / "mixed.mcap"
    hardware = ("--port", port, "--mocap", mocap)
    with_car = ("--car", f"{car}")
    made = (*with_car, "-o", f"{car}")
    return (
        Step(
            "is everything there?",
            "Switch on the car and mocap. Nothing moves.",
            ("probe", *hardware),
        ),
        Step(
            "a car file",
            "Afterwards enter wheelbase, mass and wheel track as you measured them.",
            ("config",),
            car,
        ),
        Step(
            "do units and axes agree?",
            "Push the car 1 m straight forward by hand.",
            ("mocap", "check", "--mocap", mocap, *with_car),
        ),
        Step(
            "centre and stops of the steering",
            "Lift the front wheels; the arrow keys move the servo, the motor stays off.",
            ("calibrate", "servo", "--port", port, *made),
        ),
        Step(
            "slow laps",
            "Clear 6 m by 4 m, hold the power switch. `a` arms, `s` starts, space stops.",
            ("run", *hardware, *with_car, *_laps(0.8, slow)),
        ),
        Step(
            "place of the mocap body, ERPM per m/s, delay",
            "Nothing moves.",
            ("mocap", "calibrate", f"{slow}", *made),
        ),
        Step(
            "gain and centre of the steering",
            "Nothing moves.",
            ("calibrate", "servo", f"{slow}", *made),
        ),
        Step(
            "a drive that identifies the car",
            "The same floor; the lane keeper steers, steps and swings are added.",
            ("collect", *hardware, *with_car, "--plan", "mixed", "--closed", *_laps(1.2, mixed)),
        ),
        Step(
            "the car's parameters",
            "Nothing moves.",
            ("identify", f"{mixed}", *with_car, "-o", f"{folder / 'identified.toml'}"),
        ),
    )


def _laps(speed: float, record: Path) -> tuple[str, ...]:
    """A minute of figures of eight."""
    return (*f"--path figure8 --speed {speed} --duration 60 --record".split(), f"{record}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The hardware, and where to begin."""
    option(parser, "--port", "DEV", "serial port of the VESC", required=True)
    option(parser, "--mocap", "URL", "the pose source, as `steerd run`", required=True)
    text = "where car file and sessions are kept"
    option(parser, "--folder", "DIR", text, type=Path, default=Path("setup"))
    option(parser, "--from", "N", "begin at this step", type=int, default=1, dest="first")


def run(args: argparse.Namespace) -> int:
    """Go through the steps."""
    steps = list_steps(args.port, args.mocap, args.folder)
    if not 1 <= args.first <= len(steps):
        raise SteerdError(f"--from {args.first}: there are {len(steps)} steps", "", ExitCode.USAGE)
    args.folder.mkdir(parents=True, exist_ok=True)
    left = guide(steps, args.first - 1, read_key, run_step)
    if left < len(steps):
        again = ("setup", "--port", args.port, "--mocap", args.mocap, "--folder", f"{args.folder}")
        print(f"   next: {command_line((*again, '--from', f'{left + 1}'))}")
        return ExitCode.INTERRUPTED
    print(f"   next: steerd run --port {args.port} --car {args.folder / 'identified.toml'} …")
    return ExitCode.OK


def guide(
    steps: Sequence[Step], at: int, ask: Callable[[str], str], do: Callable[[Step], int]
) -> int:
    """Go through steps as answers say; where it ended, the number of steps if all are done.

    A step that failed is offered again.

    Args:
        steps: see `list_steps`.
        at: the first.
        ask: shows a question; the answer.
        do: runs a step; its exit code.
    """
    while at < len(steps):
        step = steps[at]
        print(f"\n{at + 1} of {len(steps)}: {step.title}\n{step.before}")
        print(f"  {command_line(step.words)}" + (f" > {step.makes}" if step.makes else ""))
        answer = ask(_KEYS).strip().lower()
        if answer == "q":
            break
        if answer == "b":
            at = max(at - 1, 0)
        elif answer == "s":
            at += 1
        elif answer == "":
            code = do(step)
            at += code == 0
            if code:
                print(f"this step ended with exit code {code}: mend it and repeat it, or skip it")
    return at


def read_key(question: str) -> str:
    """The line that is typed; the end of standard input quits."""
    print(question, end="", flush=True)
    return sys.stdin.readline() or "q"


def run_step(step: Step) -> int:
    """Run the step's command in this terminal; a file that is there is kept."""
    command = [sys.executable, "-m", "steerd", *step.words]
    if step.makes is None:
        return subprocess.run(command, check=False).returncode
    if step.makes.exists():
        print(f"{step.makes} is there and stays as it is")
        return 0
    found = subprocess.run(command, check=False, stdout=subprocess.PIPE)
    if found.returncode == 0:
        step.makes.write_bytes(found.stdout)
    return found.returncode


def command_line(words: Sequence[str]) -> str:
    """A command of steerd as a shell takes it."""
    return shlex.join(["steerd", *words])
