"""What identify and diagnose found, shown and written in one order: what is quick comes first."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.car_model.car_file import CarFile
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.progress import show_progress
from steerd.daemon.common.written import Write
from steerd.posterior_file import posterior_path

if TYPE_CHECKING:
    from steerd.daemon.analysis.finding import Finding

_DRAW, _NOISE = 1.0, 8.0  # about what the report's figures and the noise cost, in sessions read


def list_outputs(args: argparse.Namespace) -> dict[str, Path | None]:
    """What is to be written, by option."""
    beside = None if args.output is None else posterior_path(args.output)
    to_file = None if _is_screen(args) else args.json
    return {"-o": args.output, "--json": to_file, "--report": args.report, "beside -o": beside}


def _is_screen(args: argparse.Namespace) -> bool:
    return str(args.json) == "-"


def present(found: "Finding", args: argparse.Namespace, write: Write) -> CarFile | None:
    """Print the screen, and write car, JSON and page.

    Args:
        found: what was found.
        args: of the command.
        write: writes one file, see `writing`.

    Returns:
        The car; None where none was asked for.

    Raises:
        SteerdError: a value is none that a car file may hold; the rest is written all the same.
    """
    text = json.dumps(found.to_json(), indent=1) + "\n"
    car, refused = None, None
    try:
        car = found.make_car(args.output) if args.output else None
    except SteerdError as error:
        refused = error
    there = write(args.output, car.text if car else None)
    write(None if _is_screen(args) else args.json, text)
    if _is_screen(args):
        print(text, end="", flush=True)
    else:
        print(found.describe(args.output if there else None, args.report), flush=True)
    # What is on the screen is written; what takes longer is added.
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
