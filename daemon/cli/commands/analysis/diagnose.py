"""Where simulation and car differ, which unmodelled effect causes it, how far adding it helps.

steerd diagnose drive.mcap --report gap.html
steerd diagnose *.mcap --base car.toml --runs-held-out last.mcap -o better.toml
steerd diagnose drive.mcap --healthy before.mcap --without grip_patch --json gap.json

Candidates are compared on one footing, the base's parameters free within their uncertainty, and
scored on windows that their fits did not see. The predicted shrinkage is written and hashed before
the drives that are kept back are opened. Exit code 3: a file cannot be read; 4: its content tells
nothing of a gap; 5: the base car's simulation diverges.
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steerd.daemon.common.errors import ExitCode, SteerdError

if TYPE_CHECKING:
    from steerd.daemon.analysis.diagnose_case import Case
    from steerd.sim_gap.diagnosis import Diagnosis
    from steerd.sim_gap.lane_comparison import LaneComparison

_LOADED, _DIAGNOSED, _DRIVEN = 0.05, 0.85, 0.95
"""Shares of the work that are done after loading, after the diagnosis, after the closed loop."""

_IDENTIFY = "a base identified from such drives: steerd identify … -o car.toml, --base car.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `steerd diagnose`."""
    parser.add_argument("sessions", nargs="+", type=Path, metavar="SESSION.mcap")
    what = parser.add_argument_group("what is compared")
    what.add_argument(
        "--base", type=Path, metavar="CAR.toml",
        help="the car as identified (default: the car file inside the session)",
    )  # fmt: skip
    what.add_argument(
        "--healthy", action="append", default=[], metavar="FILE,…",
        help="drives of the same car without the gap: they tell how large noise is",
    )  # fmt: skip
    what.add_argument(
        "--only", action="append", default=[], metavar="EFFECT", help="look at this one (repeat)"
    )
    what.add_argument(
        "--without", action="append", default=[], metavar="EFFECT", help="leave it out (repeat)"
    )
    what.add_argument("--no-pairs", action="store_true", help="one cause at most; faster")
    what.add_argument(
        "--speed",
        choices=("command", "wheel"),
        default="command",
        help="wheel: the speed command was not obeyed, take the measured speed instead",
    )
    what.add_argument(
        "--runs-held-out", action="append", default=[], metavar="K|FILE,…",
        help="measure the shrinkage on every K-th drive (default 4; 0: none), or on these files",
    )  # fmt: skip
    out = parser.add_argument_group("output")
    out.add_argument(
        "--json", nargs="?", const="-", metavar="FILE", help="for programs; alone: to the terminal"
    )
    out.add_argument("--report", type=Path, metavar="FILE.html", help="one page, plots first")
    out.add_argument(
        "-o", "--output", type=Path, metavar="CAR.toml", help="the base with the found effect"
    )
    out.add_argument(
        "--prediction", type=Path, metavar="FILE", help="the prediction, before it is measured"
    )
    out.add_argument(
        "--no-closed-loop", action="store_true", help="do not drive the session's lane again"
    )
    where = parser.add_argument_group("where")
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="candidates side by side")
    where.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler instead")


def run(args: argparse.Namespace) -> int:
    """Diagnose, print, write.

    Raises:
        SteerdError: a session, the car file or an option cannot be used.
    """
    from steerd.daemon.analysis.diagnose_case import make_case
    from steerd.daemon.analysis.diagnose_text import describe
    from steerd.daemon.common.progress import show_progress

    _check_outputs(args)
    with show_progress("diagnosing", 1.0) as advance:
        advance(0.0, "reading the drives")
        case = make_case(args, lambda share: advance(_LOADED * share))
        told = _diagnose(
            args, case, lambda stage, share: advance(_between(_LOADED, _DIAGNOSED, share), stage)
        )
        advance(_DIAGNOSED, "driving the lane again")
        lane, why = (None, "") if args.no_closed_loop else _lane(case, told)
        advance(_DRIVEN, "drawing the report" if args.report else "")
        data = make_json(case, told, lane, why)
        report = _render(case, told, lane, why) if args.report else None
    _write(args, case, told, data, report)
    if args.json == "-":
        print(json.dumps(data, indent=1))
    else:
        print(describe(case, told, lane, why, args.output, args.report))
    return ExitCode.OK


def _between(low: float, high: float, share: float) -> float:
    return low + (high - low) * share


def _check_outputs(args: argparse.Namespace) -> None:
    """What cannot be written is told before the work, not after it."""
    from steerd.daemon.common.outputs import check_outputs

    named = args.json if args.json != "-" else None
    if named is not None and named.endswith(".mcap"):
        what = f"--json {named}: that is a session"
        raise SteerdError(what, "put --json last, or --json gap.json", ExitCode.USAGE)
    check_outputs(
        {
            "--json": Path(named) if named else None,
            "--report": args.report,
            "-o": args.output,
            "--prediction": args.prediction,
        }
    )
    if args.jobs < 1:
        raise SteerdError(f"--jobs {args.jobs}: 1 or more", "", ExitCode.USAGE)


def _diagnose(
    args: argparse.Namespace, case: "Case", advance: Callable[[str, float], None]
) -> "Diagnosis":
    from numpy.linalg import LinAlgError

    from steerd.sim_gap.diagnosis import Options, diagnose
    from steerd.sysid.data.data_checks import DataError
    from steerd.sysid.parallel import DaskMissingError, on_cluster

    options = Options(
        held_out=case.held_out or (),
        healthy=case.healthy,
        only=case.only,
        without=case.without,
        pairs=not args.no_pairs,
        jobs=args.jobs,
        progress=advance,
        written=lambda text: _announce(text, args.prediction),
    )
    try:
        with on_cluster(args.dask):
            return diagnose(case.runs, case.base, options)
    except DataError as error:
        raise SteerdError(error.what, error.hint, ExitCode.INVALID) from None
    except DaskMissingError as error:
        raise SteerdError(str(error), "", ExitCode.USAGE) from None
    except FloatingPointError as error:
        raise SteerdError(str(error), _IDENTIFY, ExitCode.STOPPED) from None
    except LinAlgError:
        what = "the base car's simulation leaves every bound in some of these windows"
        raise SteerdError(what, _IDENTIFY, ExitCode.STOPPED) from None
    except (ValueError, OSError) as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None


def _announce(prediction: str, path: Path | None) -> None:
    """The prediction's digest, and the prediction itself, before anything is measured."""
    import hashlib

    from steerd.daemon.common.atomic_file import write_whole

    if path is not None:
        write_whole(path, prediction)
    digest = hashlib.sha256(prediction.encode()).hexdigest()
    print(f"predicted before measuring: sha256 {digest}", file=sys.stderr)


def _lane(case: "Case", told: "Diagnosis") -> "tuple[LaneComparison | None, str]":
    from steerd.daemon.analysis.gap_closed_loop import try_lane

    return try_lane(case.sessions, case.base, told.values)


def make_json(
    case: "Case", told: "Diagnosis", lane: "LaneComparison | None", why: str
) -> dict[str, Any]:
    """The diagnosis in the shape of `steerd.gap/1`; what it rests on is under `residual`."""
    from steerd.sim_gap.lane_comparison import encode_lane
    from steerd.sim_gap.report.to_json import to_json

    data = to_json(told)
    residual = data["residual"]
    residual["sessions"] = [path.name for path in case.sessions]
    residual["base"] = case.base_words
    residual["held_out_of"] = case.held_out_of or None
    residual["prediction"] = told.shrinkage.text
    residual["notes"] = [*case.notes, *residual["notes"], *([why] if why else [])]
    residual["closed_loop"] = None if lane is None else encode_lane(lane)
    return data


def _render(case: "Case", told: "Diagnosis", lane: "LaneComparison | None", why: str) -> str:
    from steerd.sim_gap.report.gap_report import Subject, render_report

    names = tuple(path.name for path in case.sessions)
    notes = (*case.notes, *([why] if why else ()))
    subject = Subject(names, case.seconds, case.base_words, case.held_out_of, notes)
    return render_report(subject, told, lane)


def _write(
    args: argparse.Namespace, case: "Case", told: "Diagnosis", data: dict[str, Any],
    report: str | None,
) -> None:  # fmt: skip
    """Every file whole or not at all."""
    from steerd.car_model.car_file import CarFileError, update_car
    from steerd.daemon.common.atomic_file import write_whole
    from steerd.daemon.common.translate import make_car_file_error

    if args.json and args.json != "-":
        write_whole(Path(args.json), json.dumps(data, indent=1) + "\n")
    if args.report and report is not None:
        write_whole(args.report, report)
    if args.output:
        try:
            write_whole(args.output, update_car(args.output, case.base, learned(case, told)).text)
        except CarFileError as error:
            raise make_car_file_error(error) from None


def learned(case: "Case", told: "Diagnosis") -> dict[str, Any]:
    """Updates for the car file: every parameter of the found effects."""
    from steerd.car_model.car_file import Learned

    source = f"steerd diagnose: {', '.join(path.name for path in case.sessions)}"
    return {
        f"{cause.effect}.{name}": Learned(value, sd, source)
        for cause in told.causes
        for name, (value, sd, _) in cause.parameters.items()
    }
