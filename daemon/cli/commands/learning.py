"""Commands that learn the car and find what its model lacks."""

# Why: docs/decisions/identification.md#d32

import hashlib
import json
import sys
from argparse import SUPPRESS, ArgumentParser, Namespace
from contextlib import suppress
from pathlib import Path
from typing import Any

from steerd.car_model.car_file import CarFile
from steerd.daemon.analysis.options import Finding, Watch, read_arguments
from steerd.daemon.cli import arguments
from steerd.daemon.cli.arguments import missing_car, missing_session, option, split_list
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import print_labelled, print_warnings, show_progress, wrap
from steerd.daemon.common.written import Write, writing
from steerd.posterior_file import posterior_path

_SPEED = "wheel: the speed command was not obeyed, take the measured speed instead"
_SCREEN = Path("-")
_HELD_OUT: dict[str, Any] = {"type": arguments.split_held_out, "action": "extend"}
_DRAW, _NOISE = 1.0, 8.0  # about what the report's figures and the noise cost, in sessions read


def identify_arguments(parser: ArgumentParser) -> None:
    arguments.add_sessions(parser)
    what = parser.add_argument_group("what is learnt")
    option(what, "--car", "FILE.toml", "start values (F1TENTH's)", missing_car, type=Path)
    option(what, "--base", None, SUPPRESS, dest="car", type=Path)
    option(what, "--free", "A,B,…", "free parameters (default: all)", type=split_list, default=())
    option(what, "--fix", "A,B=VALUE,…", "keep these as they are", type=parse_fix, default={})
    option(what, "--wheelbase", "M", "distance of the axles, measured", type=float)
    option(what, "--speed", None, _SPEED, choices=("command", "wheel"), default="command")
    text = "learn only these effects of the library (default, auto: all that the drives show)"
    effects: dict[str, Any] = {"type": lambda t: t if t == "auto" else split_list(t), "default": ()}
    option(what, "--effects", "auto|A,B,…", text, **effects)
    text = "our own, or one of the paper's"
    option(what, "--method", None, text, choices=("ours", "paper", "cma-es"), default="ours")
    option(what, "--starts", "N", "starts (ours: 1, others: 5)", type=int)
    option(what, "--iterations", "N", "of the paper's methods", type=int)
    option(what, "--seed", None, "of random starts", type=int, default=0)
    text = "validate on every K-th block of 5 s (default 4), or on these sessions"
    option(what, "--held-out", "K|FILE,…", text, missing_session, **_HELD_OUT)
    out = parser.add_argument_group("output")
    option(out, "-o --output", "CAR.toml", "car file to write", type=Path)
    option(out, "--json", "FILE", "the result for programs; -: to the terminal", type=Path)
    option(out, "--report", "FILE.html", "the result with figures", type=Path)
    option(parser.add_argument_group("where"), "--jobs", "N", "processes", type=int, default=1)


def identify(args: Namespace) -> int:
    """Identify a car from sessions: parameters with error bars, and a car file.

    steerd identify drive1.mcap drive2.mcap -o car.toml --report identify.html
    steerd identify *.mcap --wheelbase 0.324 --fix mass=3.2 --held-out last.mcap

    What is not identifiable from the data is named, with the manoeuvre that would
    identify it. Values are validated on held-out drives (or blocks of 5 s). Exit
    code 3: a file cannot be read; 4: its content is not fit for identification; 5:
    the result predicts no better than the start values.
    """
    from steerd.daemon.analysis.identification import IdentifyOptions, run_identify
    from steerd.daemon.assembly.build import report_refusal

    with writing(list_outputs(args), announced=True) as write:
        paths = [*map(arguments.pick_session, args.sessions)]
        with show_progress("identifying", 1.0) as advance:
            options = read_arguments(IdentifyOptions, args)
            found = run_identify(paths, options, Watch(print_warnings, advance))
        car = present(found, args, write)
    if car is not None:
        report_refusal(car)
    return ExitCode.OK if found.improved else ExitCode.STOPPED


def parse_fix(text: str) -> dict[str, float | None]:
    """The values of `--fix` by name, None where a name stands alone; a SteerdError if no number."""
    fixed: dict[str, float | None] = {}
    for part in split_list(text):
        name, equals, number = part.partition("=")
        try:
            fixed[name] = float(number) if equals else None
        except ValueError:
            raise UsageError(f"--fix {part}: not a number") from None
    return fixed


def diagnose_arguments(parser: ArgumentParser) -> None:
    arguments.add_sessions(parser)
    what = parser.add_argument_group("what is compared")
    text = "the car as identified (default: the car file inside the session)"
    option(what, "--base", "CAR.toml", text, missing_car, type=Path)
    option(what, "--car", None, SUPPRESS, dest="base", type=Path)
    text = "drives of the same car without the gap: they determine how large noise is"
    drives: dict[str, Any] = {"type": lambda t: [*map(Path, split_list(t))], "default": []}
    option(what, "--healthy", "FILE,…", text, missing_session, action="extend", **drives)
    option(what, "--only", "EFFECT", "look at this one (repeat)", action="append")
    option(what, "--without", "EFFECT", "leave it out (repeat)", action="append")
    option(what, "--no-pairs", "", "one cause at most; faster", dest="pairs", action="store_false")
    option(what, "--speed", None, _SPEED, choices=("command", "wheel"), default="command")
    text = "measure the shrinkage on every K-th drive (default 4; 0: none), or on these files"
    option(what, "--held-out", "K|FILE,…", text, missing_session, **_HELD_OUT)
    out = parser.add_argument_group("output")
    text = "for programs; alone: to the terminal"
    option(out, "--json", "FILE", text, nargs="?", const=_SCREEN, type=Path)
    option(out, "--report", "FILE.html", "one page, plots first", type=Path)
    option(out, "-o --output", "CAR.toml", "the base with the found effect", type=Path)
    option(out, "--prediction", "FILE", "the prediction, before it is measured", type=Path)
    text = "do not drive the session's lane again"
    option(out, "--no-closed-loop", "", text, dest="closed_loop", action="store_false")


def diagnose(args: Namespace) -> None:
    """Where simulation and car differ, the effect that causes it, and its benefit.

    steerd diagnose drive.mcap --report gap.html
    steerd diagnose *.mcap --base car.toml --held-out last.mcap -o better.toml
    steerd diagnose drive.mcap --healthy before.mcap --json gap.json

    Candidates are compared on one footing, the base's parameters free within their
    uncertainty, and scored on windows that their fits did not see. The predicted
    shrinkage is written and hashed before the held-out drives are opened. Exit code
    3: a file cannot be read; 4: a gap is not identifiable from its content; 5: the
    base car's simulation diverges.
    """
    from steerd.daemon.analysis.diagnosis import DRIVEN, DiagnoseOptions, run_diagnose
    from steerd.daemon.assembly.build import report_refusal

    if args.json is not None and args.json.suffix == ".mcap":
        what = f"--json {args.json}: that is a session"
        raise UsageError(what, "put --json last, or --json gap.json")
    named = {**list_outputs(args), "--prediction": args.prediction}
    with writing(named, announced=True) as write:

        def foretell(text: str) -> None:
            """The prediction's digest, and the prediction itself, before anything is measured."""
            digest = hashlib.sha256(text.encode()).hexdigest()
            print(f"predicted before measuring: sha256 {digest[:16]}…", file=sys.stderr)
            write(args.prediction, text)

        options = read_arguments(DiagnoseOptions, args)
        paths = [*map(arguments.pick_session, args.sessions)]
        with show_progress("diagnosing", 1.0) as advance:
            found = run_diagnose(paths, options, Watch(print_warnings, advance, foretell))
            advance(DRIVEN, "")
        car = present(found, args, write)
        write(args.prediction, found.findings.shrinkage.text)  # where it could not be, at first
    if car is not None:
        report_refusal(car)


def list_outputs(args: Namespace) -> dict[str, Path | None]:
    """What is to be written, by option."""
    beside = None if args.output is None else posterior_path(args.output)
    to_file = None if args.json == _SCREEN else args.json
    return {"-o": args.output, "--json": to_file, "--report": args.report, "beside -o": beside}


def present(found: Finding, args: Namespace, write: Write) -> CarFile | None:
    """Print the screen, write car, JSON and page; the car, None where none was asked for.

    Where a value is none that a car file may hold, a SteerdError after the rest is written.
    """
    text = json.dumps(found.to_json(), indent=1) + "\n"
    car, refused = None, None
    try:
        car = found.make_car(args.output) if args.output else None
    except SteerdError as error:
        refused = error
    there = write(args.output, car.text if car else None)
    if args.json != _SCREEN:
        write(args.json, text)
        text = found.describe(args.output if there else None, args.report) + "\n"
    with suppress(BrokenPipeError):  # what takes longer is added, also where nobody reads on
        print(text, end="", flush=True)
    drawn = _DRAW if args.report else 0.0
    with show_progress("writing", drawn + (_NOISE if there else 0.0)) as advance:
        advance(0.0, "drawing the report" if args.report else "")
        write(args.report, found.render_report() if args.report else None)
        if car is not None and there:
            advance(drawn, "learning the noise for diagnose")
            write(posterior_path(args.output), found.learn_known(car).posterior or None)
    if refused is not None:
        what = f"{args.output} is not written: {refused.what.removeprefix(f'{args.output}: ')}"
        raise SteerdError(what, "no car is like that; see the notes above", ExitCode.STOPPED)
    return car


def learn_arguments(parser: ArgumentParser) -> None:
    arguments.add_session(parser)
    base = "the car as believed (default: the session's)"
    option(parser, "--base", "FILE.toml", base, missing_car, type=Path)
    option(parser, "--json", "", "the same for programs")


def learn(args: Namespace) -> None:
    """Parameters learnt during a drive, as they came, and when the car changed.

    The learner of `steerd run --learn` on a recorded drive. It learns the car in
    the first 25 s of driving, follows it, and says when it changed, and how.

    steerd learn RUN.mcap
    steerd learn RUN.mcap --base car.toml --json
    """
    from steerd.daemon.analysis.learning import learn_session
    from steerd.daemon.learning.reported import encode_model, format_model

    path = arguments.pick_session(args.session)
    with show_progress("learning", 1.0) as advance:
        found = learn_session(path, args.base, share=advance)
    newest = found.reports[-1]
    if found.remark:
        print_labelled("note: ", found.remark, sys.stderr)
    if args.json:
        reports = {"count": len(found.reports), "sha256": found.digest}
        values = {"schema": "steerd.learn/1", **encode_model(newest), "reports": reports}
        print(json.dumps(values, indent=1, allow_nan=False))
        return
    about = f"{path.name}: {newest.windows} half seconds of driving, about {found.base}"
    print(*wrap(about, "", "  "), *format_model(newest), sep="\n")
    if found.recorded:
        print(f"reports in the session: {found.same} of {found.recorded} the same to the byte")
    print(f"{len(found.reports)} reports, sha256 {found.digest[:16]}")
