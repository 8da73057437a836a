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

from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.car_model.car_file import CarFile
    from steerd.sysid.data.dataset import Run
    from steerd.sysid.estimation.learn import Task
    from steerd.sysid.estimation.outcome import Outcome

_FIT, _DRAW, _NOISE = 2.0, 1.0, 8.0
"""About what the fit, the report's figures and the noise cost, in sessions read."""


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
    out.add_argument(
        "--json", type=Path, metavar="FILE", help="the result for programs; -: to the terminal"
    )
    out.add_argument("--report", type=Path, metavar="FILE.html", help="the result with figures")
    where = parser.add_argument_group("where")
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    where.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler instead")


def run(args: argparse.Namespace) -> int:
    """Identify, print, write.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    from steerd.car_model.car_file import default_car_path
    from steerd.daemon.analysis.drives import load_base
    from steerd.daemon.analysis.identify_case import make_task
    from steerd.daemon.analysis.identify_text import describe, improved
    from steerd.daemon.common.outputs import check_outputs
    from steerd.daemon.common.progress import show_progress
    from steerd.sysid.estimation.outcome import encode_outcome

    named = None if _to_screen(args) else args.json
    check_outputs({"-o": args.output, "--json": named, "--report": args.report})
    base = load_base(args.car or default_car_path())
    read = float(len(args.sessions) + len(args.held_out))
    drawn = read + _FIT + (_DRAW if args.report else 0.0)
    with show_progress("identifying", drawn + (_NOISE if args.output else 0.0)) as advance:
        advance(0.0, "reading the drives")
        task = make_task(args, base)
        advance(read, "fitting the car")
        outcome = _learn(task)
        advance(read + _FIT, "drawing the report" if args.report else "")
        report = _render(outcome) if args.report else None
        advance(drawn, "learning the noise for diagnose" if args.output else "")
        car = _car_text(args, base, outcome, task.runs) if args.output else None
    result = json.dumps(encode_outcome(outcome), indent=1) + "\n"
    _write({args.report: report, named: result, args.output: car})
    if _to_screen(args):
        print(result, end="")
    else:
        print(describe(outcome, args.output, axles_measured=args.wheelbase is not None))
    return ExitCode.OK if improved(outcome) else ExitCode.STOPPED


def _to_screen(args: argparse.Namespace) -> bool:
    return str(args.json) == "-"


def _learn(task: "Task") -> "Outcome":
    from steerd.sysid.data.data_checks import DataError
    from steerd.sysid.estimation.learn import learn
    from steerd.sysid.paper.search_history import BaselineMissingError
    from steerd.sysid.parallel import DaskMissingError

    try:
        return learn(task, time.perf_counter)
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None
    except (BaselineMissingError, DaskMissingError) as error:
        raise SteerdError(str(error), "", ExitCode.USAGE) from None
    except FloatingPointError as error:
        hint = "give start values nearer to the car: --car FILE.toml, --wheelbase"
        raise SteerdError(str(error), hint, ExitCode.STOPPED) from None
    except (ValueError, OSError) as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None


def _render(outcome: "Outcome") -> str:
    from steerd.sysid.report.identify_report import render_report

    return render_report(outcome)


def _write(texts: dict[Path | None, str | None]) -> None:
    """Every file whole or not at all."""
    from steerd.daemon.common.atomic_file import write_whole

    for path, text in texts.items():
        if path is not None and text is not None:
            write_whole(path, text)


def _car_text(
    args: argparse.Namespace, base: "CarFile", outcome: "Outcome", runs: "tuple[Run, ...]"
) -> str:
    """The car file that comes out; nothing of it is written before all of it is known."""
    from steerd.car_model.car_file import CarFileError, parse_car, updated_text
    from steerd.daemon.analysis.identify_case import given_values
    from steerd.daemon.common.translate import make_car_file_error

    try:
        updates = {**given_values(args.fix), **learned(outcome)}
        text = updated_text(base, {**_carried(base, outcome), **updates})
        return with_noise(parse_car(text, args.output), runs)
    except CarFileError as error:
        raise make_car_file_error(error) from None


def _carried(base: "CarFile", outcome: "Outcome") -> dict[str, Any]:
    """What --wheelbase and a stated mass moved, and nothing fitted: as it was while fitting."""
    from steerd.car_model.car_file import Learned

    return {
        name: Learned(getattr(outcome.after, name), None, "follows from what was stated")
        for name in ("lf", "lr", "inertia_z")
        if getattr(outcome.after, name) != getattr(base.model.car, name)
    }


def with_noise(car: "CarFile", runs: "tuple[Run, ...]") -> str:
    """The car file's text with `[noise]`: how large what no car explains was in these drives.

    `steerd diagnose` judges other drives of the car by it, cut like these to where the car moves: a
    standing car is quieter. The file stays without where the drives do not tell it.
    """
    import tomlkit

    from steerd.sim_gap.engine.noise import noise_section
    from steerd.sim_gap.healthy_drives import learn_healthy
    from steerd.sysid.data.segments import moving_segments
    from steerd.sysid.estimation.prediction_horizon import remembering

    document = tomlkit.parse(car.text)
    try:
        drives = moving_segments(remembering(runs, car.model, ()))
        document["noise"] = noise_section(learn_healthy(car, drives))
    except (ValueError, FloatingPointError):
        return car.text
    return tomlkit.dumps(document)


def learned(outcome: "Outcome") -> dict[str, Any]:
    """Updates for the car file: every free parameter with its error and provenance."""
    from steerd.car_model.car_file import Learned

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


def _servo_wait(outcome: "Outcome") -> str:
    """What a fitted dead time of the steering holds."""
    if outcome.pulses:
        return "; half a frame (10 ms) is the mean wait for a pulse of the 50 Hz servo signal"
    return "; whatever the servo's signal waits is in it"


def _effect_updates(outcome: "Outcome", names: str) -> dict[str, Any]:
    from steerd.car_model.car_file import Learned

    found = outcome.fit.estimates if outcome.fit else {}
    return {
        name: Learned(e.value, e.sd, f"steerd identify: {names}")
        for name, e in found.items()
        if "." in name
    }
