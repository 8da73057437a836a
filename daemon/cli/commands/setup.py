"""`steerd setup`: the steps from a car that nobody has measured to its car file."""

import shlex
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from steerd.daemon.cli.arguments import option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import wrap_command
from steerd.daemon.common.written import dated_name


class Step(NamedTuple):
    """One step: what it finds out, and what to do before it and to look at."""

    title: str
    before: str
    words: tuple[str, ...]  # the command's arguments after `steerd`
    makes: Path | None = None  # what its standard output is written to; None for the terminal

    @property
    def typed(self) -> str:
        """The command as a user would type it."""
        return f"steerd {shlex.join(self.words)}" + (f" > {self.makes}" if self.makes else "")


_STEPS = """\
is everything there? | Switch on the car and mocap. Nothing moves.
probe {hardware}
a car file | Then set lf + lr, the wheelbase, and mass in it, as you measured them.
config > {car}
do units and axes agree? | Push the car 1 m straight forward (`steerd sim`: Enter there).
mocap check --mocap {mocap} --car {car}
centre and stops of the steering | Lift the front wheels; arrows steer. Simulated: only w.
calibrate servo --port {port} --car {car} -o {car}
slow laps | Clear 6 m by 4 m, hold the power switch. `a` arms, `s` starts, space stops.
run {hardware} --car {car} --path figure8 --speed 0.8 --duration 60 --record {slow}
place of the mocap body, ERPM per m/s, delay | Nothing moves.
mocap calibrate {slow} --car {car} -o {car}
gain and centre of the steering | Nothing moves.
calibrate servo {slow} --car {car} -o {car}
a drive that identifies the car | The same floor; steps and swings are added to the lane keeper's.
collect {hardware} --car {car} --closed --path figure8 --speed 1.2 --duration 60 --record {mixed}
the car's parameters | Nothing moves.
identify {mixed} --car {car} -o {identified}
"""
"""Title and preparation, and the command, of each step."""


def list_steps(port: str, mocap: str, folder: Path) -> tuple[Step, ...]:
    """What is done for a car, in order; files lie in the folder."""
    places = {"port": port, "mocap": mocap} | {
        name.partition(".")[0]: f"{folder / name}"
        for name in ("car.toml", "slow.mcap", "mixed.mcap", "identified.toml")
    }
    quoted = {name: shlex.quote(text) for name, text in places.items()}
    quoted["hardware"] = "--port {port} --mocap {mocap}".format(**quoted)
    lines = _STEPS.splitlines()
    steps = []
    for about, command in zip(lines[::2], lines[1::2], strict=True):
        title, _, before = about.partition(" | ")
        words, _, makes = command.partition(" > ")
        made = tuple(shlex.split(words.format(**quoted)))
        steps.append(Step(title, before, made, folder / "car.toml" if makes else None))
    return tuple(steps)


def setup_arguments(parser: ArgumentParser) -> None:
    option(parser, "--port", "DEV", "serial port of the VESC", required=True)
    option(parser, "--mocap", "URL", "the pose source, as `steerd run`", required=True)
    option(parser, "--folder", "DIR", "of car file and drives", type=Path, default=Path("setup"))
    option(parser, "--from", "N", "begin at this step", type=int, default=1, dest="first")
    text = "the steps in a browser on this machine too; keys stay in the terminal"
    option(parser, "--page", "PORT", text, nargs="?", type=int, const=0)


def setup(args: Namespace) -> int | None:
    """From a car that nobody has measured to its identified car file, step by step.

    steerd setup --port /dev/ttyACM0 --mocap natnet://HOST/car

    Each step is a command of steerd: its line is shown, runs on Enter, and prints
    what it measured with its error. A step can be repeated, skipped, or run by
    hand. Nothing moves before you arm and start it with the keys that `run` shows.
    """
    steps = list_steps(args.port, args.mocap, args.folder)
    if not 1 <= args.first <= len(steps):
        raise UsageError(f"--from {args.first}: there are {len(steps)} steps")
    args.folder.mkdir(parents=True, exist_ok=True)
    hardware = ["--port", args.port, "--mocap", args.mocap]
    if args.page is None:
        left = guide(steps, args.first - 1, read_key, run_step)
    else:
        from steerd.daemon.process.guide_page import GuidePage  # with a web server

        page = GuidePage([
            {"title": step.title, "before": step.before, "command": step.typed} for step in steps
        ])  # fmt: skip
        try:
            print(f"   page: {page.open(args.page)} (in a browser on this machine)")
        except OSError as error:
            hint = "--page with another port"
            raise SteerdError(f"--page {args.page}: {error}", hint, ExitCode.UNREACHABLE) from error
        do = partial(run_step, execute=page.run)
        left = guide(steps, args.first - 1, page.ask, do, page.stand)
    if left < len(steps):
        again = shlex.join(["setup", *hardware, "--folder", str(args.folder)])
        print(f"   next: steerd {again} --from {left + 1}")
        return ExitCode.INTERRUPTED
    car = str(args.folder / "identified.toml")
    print(f"   next: steerd {shlex.join(['run', *hardware, '--car', car])}")
    return None


def guide(
    steps: Sequence[Step],
    at: int,
    ask: Callable[[str], str],
    do: Callable[[Step], int],
    stand: Callable[[int, str], None] = lambda at, state: None,
) -> int:
    """Go through steps as answers say; where it ended, the number of steps if all are done.

    `ask` shows a question and gives the answer, `do` runs a step and gives its exit code, `stand`
    hears of the present step, and whether it is `asked`, `runs`, `done` or `failed`.
    """
    while at < len(steps):
        step = steps[at]
        print(f"\n{at + 1} of {len(steps)}: {step.title}\n{step.before}")
        print(*wrap_command(step.typed, "  ", " " * 4), sep="\n")
        stand(at, "asked")
        answer = ask("[Enter] do it   [s] skip   [b] back   [q] quit: ").strip().lower()
        if answer == "q":
            break
        if answer == "b":
            at = max(at - 1, 0)
        elif answer == "s":
            at += 1
        elif answer == "":
            stand(at, "runs")
            code = do(step)
            stand(at, "failed" if code else "done")
            at += code == 0
            if code:
                print(f"this step ended with exit code {code}: fix it and repeat it, or skip it")
    return at


def read_key(question: str) -> str:
    """The line that is typed; the end of standard input quits."""
    print(question, end="", flush=True)
    return sys.stdin.readline() or "q"


def run_step(step: Step, execute: Callable[[Sequence[str]], int] = subprocess.call) -> int:
    """Run the step's command in this terminal; a file that is there is kept."""
    command = [sys.executable, "-m", "steerd", *step.words]
    drive = Path(step.words[-1])
    if "--record" in step.words and drive.exists():  # a session is never written over
        print(f"what {drive} was before is kept as {drive.rename(dated_name(drive))}")
    if step.makes and step.makes.exists():
        print(f"{step.makes} is there and stays as it is")
        return 0
    if not step.makes:
        return execute(command)
    found = subprocess.run(command, check=False, stdout=subprocess.PIPE)
    if found.returncode == 0:
        step.makes.write_bytes(found.stdout)
        print(f"{step.makes}: written")
    return found.returncode
