"""Learn the car from recorded sessions: parameters with error bars, and a car file to drive with.

steerd identify drive1.mcap drive2.mcap -o car.toml --report identify.html
steerd identify *.mcap --wheelbase 0.324 --fix mass=3.2 --held-out last.mcap

What the data do not tell is named, with the manoeuvre that would tell it. Values are judged on
drives (or blocks of 5 s) that were kept back. Exit code 3: a file cannot be read; 4: its content is
not fit for identification; 5: the result predicts no better than the start values.
"""

import argparse
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.drives import load_drive
from daemon.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from car_model.car_file import CarFile
    from car_model.params import Car
    from sysid.dataset import Run
    from sysid.learn import Task
    from sysid.outcome import Outcome

_USAGE = ExitCode.USAGE
_STARTS = {"ours": 1, "paper": 5, "cma-es": 5}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd identify`."""
    parser.add_argument("sessions", nargs="+", type=Path, metavar="SESSION.mcap")
    what = parser.add_argument_group("what is learnt")
    what.add_argument("--car", type=Path, metavar="FILE.toml", help="start values (F1TENTH's)")
    what.add_argument("--free", metavar="A,B,…", help="free parameters (default: all eleven)")
    what.add_argument("--fix", default="", metavar="A,B=VALUE,…", help="keep these as they are")
    what.add_argument(
        "--wheelbase", type=float, metavar="M", help="distance of the axles, measured"
    )
    what.add_argument(
        "--speed",
        choices=("command", "wheel"),
        default="command",
        help="wheel: the speed command was not obeyed, take the measured speed instead",
    )
    what.add_argument(
        "--effects",
        metavar="auto|A,B,…",
        help="of these effects (auto: a real car's usual ones), learn those that the drives show",
    )
    what.add_argument("--method", choices=("ours", "paper", "cma-es"), default="ours")
    what.add_argument("--starts", type=int, metavar="N", help="starts (ours: 1, others: 5)")
    what.add_argument("--iterations", type=int, metavar="N", help="of the paper's methods")
    what.add_argument("--seed", type=int, default=0, help="of random starts")
    what.add_argument(
        "--held-out",
        action="append",
        default=[],
        metavar="K|FILE",
        help="validate on every K-th block of 5 s (default 4), or on these sessions",
    )
    out = parser.add_argument_group("output")
    out.add_argument("-o", "--output", type=Path, metavar="CAR.toml", help="car file to write")
    out.add_argument("--json", type=Path, metavar="FILE", help="the result for programs")
    out.add_argument("--report", type=Path, metavar="FILE.html", help="the result with figures")
    where = parser.add_argument_group("where")
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    where.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler instead")


def run(args: argparse.Namespace) -> int:
    """Identify, print, write.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    from daemon.identify_text import describe, improved
    from daemon.progress import show_progress

    base = _load_base(args)
    files, every = _held_out(args.held_out)
    count = len(args.sessions) + len(files)
    with show_progress("identifying", count + 3.0) as advance:
        task = make_task(args, base, files, every)
        advance(float(count))
        outcome = _learn(task)
        advance(count + 2.0)
        report = _render(outcome) if args.report else None
    good = improved(outcome)
    _write(args, base, outcome, report, task.runs)
    print(describe(outcome, args.output, axles_measured=args.wheelbase is not None))
    return ExitCode.OK if good else ExitCode.STOPPED


def _load_base(args: argparse.Namespace) -> "CarFile":
    from car_model.car_file import CarFileError, default_car_path, load_car

    try:
        return load_car(args.car or default_car_path())
    except CarFileError as error:
        raise SteerdError(str(error), error.hint, ExitCode.INVALID) from None


def _held_out(given: list[str]) -> tuple[list[Path], int]:
    """Files, or the k of every k-th block."""
    if len(given) == 1 and given[0].isdigit():
        if int(given[0]) < 2:
            raise SteerdError("--held-out K: every K-th block, 2 or more", "", _USAGE)
        return [], int(given[0])
    return [Path(each) for each in given], 4


def make_task(args: argparse.Namespace, base: "CarFile", files: list[Path], every: int) -> "Task":
    """Everything that is to be done, checked.

    Raises:
        SteerdError: a session or an option cannot be used.
    """
    from car_model.params import Car
    from sysid.fit import DEFAULT_FREE, Options
    from sysid.learn import Task, fit_wheelbase, free_names
    from sysid.reach import level_loads, scale_inertia

    fixed, values = _parse_fix(args.fix)
    model = base.model._replace(car=base.car._replace(**values))
    free = [part for part in (args.free or "").split(",") if part]
    for name in (*free, *fixed):
        if name not in Car._fields and "." not in name:
            known = ", ".join(Car._fields)
            raise SteerdError(f"{name} is no parameter of the car", f"one of {known}", _USAGE)
    if args.wheelbase is not None and not 0.05 <= args.wheelbase <= 2.0:
        raise SteerdError(f"--wheelbase {args.wheelbase:g}: in metres", "", _USAGE)
    candidates = _candidates(args.effects)
    model = fit_wheelbase(model, args.wheelbase)
    stated = {*free, *fixed}
    if "inertia_z" not in stated:
        model = scale_inertia(model, base.model)
    runs = tuple(load_drive(path, args.speed) for path in args.sessions)
    if "cog_height" not in stated:
        model = level_loads(model, runs)
    return Task(
        runs=runs,
        held_out=tuple(load_drive(path, args.speed) for path in files),
        every=every,
        model=model,
        options=Options(free=free_names(free, fixed, DEFAULT_FREE), wheelbase=args.wheelbase),
        method=args.method,
        starts=args.starts or _STARTS[args.method],
        iterations=args.iterations,
        seed=args.seed,
        jobs=args.jobs,
        dask=args.dask,
        truth=_truth(args.sessions[0]),
        effects=candidates,
    )


def _candidates(given: str | None) -> tuple[str, ...]:
    """Effects to look for."""
    from car_model.effects import find_effect
    from sysid.manners import CANDIDATES

    if given in (None, "", "auto"):
        return CANDIDATES if given == "auto" else ()
    try:
        return tuple(find_effect(name).name for name in str(given).split(",") if name)
    except ValueError as error:
        what, _, hint = str(error).partition("; ")
        raise SteerdError(what, hint or "`steerd effects` lists them", _USAGE) from None


def _truth(path: Path) -> "Car[float] | None":
    """The simulated car of a session that was recorded in simulation."""
    from car_model.params import Car
    from steer_bus.session_read import open_session

    metadata = open_session(path).info().metadata
    vehicle = metadata.get("steerd.vehicle", {})
    if metadata.get("steerd.session", {}).get("mode") != "sim":
        return None
    try:
        return Car(**{name: float(vehicle[name]) for name in Car._fields})
    except (KeyError, ValueError):
        return None


def _parse_fix(text: str) -> tuple[list[str], dict[str, float]]:
    """Names to keep, and the values given for some of them."""
    names, values = [], {}
    for part in (p for p in text.split(",") if p):
        name, equals, number = part.partition("=")
        names.append(name)
        if equals:
            try:
                values[name] = float(number)
            except ValueError:
                raise SteerdError(f"--fix {part}: not a number", "", _USAGE) from None
    return names, values


def _learn(task: "Task") -> "Outcome":
    from sysid.course import BaselineMissingError
    from sysid.gate import DataError
    from sysid.learn import learn
    from sysid.scale import DaskMissingError

    try:
        return learn(task, time.perf_counter)
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None
    except (BaselineMissingError, DaskMissingError) as error:
        raise SteerdError(str(error), "", _USAGE) from None
    except FloatingPointError as error:
        hint = "give start values nearer to the car: --car FILE.toml, --wheelbase"
        raise SteerdError(str(error), hint, ExitCode.STOPPED) from None
    except (ValueError, OSError) as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None


def _render(outcome: "Outcome") -> str:
    from sysid.report import render_report

    return render_report(outcome)


def _write(
    args: argparse.Namespace,
    base: "CarFile",
    outcome: "Outcome",
    report: str | None,
    runs: "tuple[Run, ...]" = (),
) -> None:
    """Every file whole or not at all."""
    from car_model.car_file import CarFileError, save_car
    from daemon.whole_file import write_whole
    from sysid.outcome import encode_outcome

    if args.json:
        write_whole(args.json, json.dumps(encode_outcome(outcome), indent=1) + "\n")
    if args.report and report is not None:
        write_whole(args.report, report)
    if args.output:
        try:
            car = save_car(args.output, base, {**_given(args.fix), **learned(outcome)})
        except CarFileError as error:
            raise SteerdError(str(error), error.hint, ExitCode.INVALID) from None
        if runs:
            write_whole(args.output, with_noise(car, runs))


def with_noise(car: "CarFile", runs: "tuple[Run, ...]") -> str:
    """The car file's text with `[noise]`: how large what no car explains was in these drives.

    `steerd diagnose` judges other drives of the car by it. The file stays without where the drives
    do not tell it.
    """
    import tomlkit

    from sim_gap.healthy import learn_healthy
    from sim_gap.noise import noise_section
    from sysid.reach import remembering

    document = tomlkit.parse(car.text)
    try:
        drives = remembering(runs, car.model, ())
        document["noise"] = noise_section(learn_healthy(car, drives))
    except (ValueError, FloatingPointError):
        return car.text
    return tomlkit.dumps(document)


def learned(outcome: "Outcome") -> dict[str, Any]:
    """Updates for the car file: every free parameter with its error and provenance."""
    from car_model.car_file import Learned

    names = ", ".join(outcome.sessions)
    updates = {}
    for name, row in outcome.rows.items():
        if row.free:
            source = f"steerd identify ({outcome.method}): {names}"
            source += "" if row.identifiable else "; not told by these data"
            source += _servo_wait(outcome) if name == "steer_delay" else ""
            updates[name] = Learned(row.value, row.sd, source)
        elif row.value != row.before:
            updates[name] = Learned(row.value, None, f"steerd identify: {names}")
    if outcome.fit is not None:
        updates |= _effect_updates(outcome, names)
    return updates


def _given(text: str) -> dict[str, Any]:
    """What the user stated: the file that comes out is of that car."""
    from car_model.car_file import Learned

    _, values = _parse_fix(text)
    return {name: Learned(value, None, "given with --fix") for name, value in values.items()}


def _servo_wait(outcome: "Outcome") -> str:
    """What a fitted dead time of the steering holds."""
    if outcome.pulses:
        return "; half a frame (10 ms) is the mean wait for a pulse of the 50 Hz servo signal"
    return "; whatever the servo's signal waits is in it"


def _effect_updates(outcome: "Outcome", names: str) -> dict[str, Any]:
    from car_model.car_file import Learned

    found = outcome.fit.estimates if outcome.fit else {}
    return {
        name: Learned(e.value, e.sd, f"steerd identify: {names}")
        for name, e in found.items()
        if "." in name
    }
