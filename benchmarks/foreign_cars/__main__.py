"""Command line: `python -m benchmarks.foreign_cars make | draw | judge | table`."""

import argparse
import secrets
import sys
from pathlib import Path

from benchmarks.blind_gap.effects import SIZES
from benchmarks.blind_gap.seal import SealError
from benchmarks.foreign_cars.bank import Shares, draw_cases, load_cases, save_cases
from benchmarks.foreign_cars.cases import Case, healthy_logs, later_logs, write_logs
from benchmarks.foreign_cars.drives import PUSH, SECONDS, TEMPERS
from benchmarks.foreign_cars.effects import UnknownEffectError
from benchmarks.foreign_cars.judge import ROWS, TOOL, judge, read_rows
from benchmarks.foreign_cars.plants import PLANTS, MissingPlantError
from benchmarks.foreign_cars.table import format_cases, format_table


def _make(args: argparse.Namespace) -> str:
    hidden = tuple((name, args.severity) for name in args.effect)
    case = Case(args.plant, args.seed, args.number, hidden, args.temper, args.seconds, args.push)
    write_logs(args.output, "healthy", healthy_logs(case))
    logs, labels = later_logs(case)
    write_logs(args.output, "later", logs)
    return (
        f"{args.output}: healthy-1, -2, later-1, -2, -3 and map.toml; hidden: {labels or 'nothing'}"
    )


def _draw(args: argparse.Namespace) -> str:
    nonce = secrets.randbits(62) if args.nonce is None else args.nonce
    shares = Shares(args.nulls, args.singles, args.pairs, args.outside, args.cars)
    cases = draw_cases(nonce, shares, args.plants.split(","), args.temper, args.push)
    digest = save_cases(args.output, cases, args.seal)
    return f"{len(cases)} cases; publish this first: {digest}  {args.output.name}"


def _judge(args: argparse.Namespace) -> str:
    cases = load_cases(args.cases, args.key)
    return _both(judge(cases[: args.limit], args.output, args.tool, args.jobs, args.tape))


def _both(rows: list[dict[str, object]]) -> str:
    return f"{format_cases(rows)}\n\n{format_table(rows)}"


def _table(args: argparse.Namespace) -> str:
    return _both([row for folder in args.output for row in read_rows(folder / ROWS)])


def make_parser() -> argparse.ArgumentParser:
    """The commands and their options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.foreign_cars", description=__doc__)
    commands = parser.add_subparsers(required=True)
    make = commands.add_parser("make", help="write the tables of one case")
    make.add_argument("--plant", choices=PLANTS, required=True)
    make.add_argument("--seed", type=int, required=True, help="which car")
    make.add_argument("--number", type=int, default=0, help="which later drives of it")
    make.add_argument("--effect", action="append", default=[], help="repeat for a pair; none: null")
    make.add_argument("--severity", choices=SIZES, default="medium")
    make.add_argument("--seconds", type=float, default=SECONDS)
    make.set_defaults(act=_make)
    draw = commands.add_parser("draw", help="write a list of cases")
    draw.add_argument("--plants", default=",".join(PLANTS))
    draw.add_argument("--nonce", type=int, help="draws the same list again")
    for name, default in (("nulls", 3), ("singles", 6), ("pairs", 0), ("outside", 0), ("cars", 3)):
        draw.add_argument(f"--{name}", type=int, default=default, help="for each plant")
    draw.add_argument("--seal", action="store_true", help="encrypt it; the key lies beside it")
    draw.set_defaults(act=_draw)
    ask = commands.add_parser("judge", help="run the tool on a list, print the table")
    ask.add_argument("cases", type=Path)
    ask.add_argument("--key", type=Path, help="of a sealed list")
    ask.add_argument("--limit", type=int)
    ask.add_argument("--tool", default=TOOL, help="command that starts the tool")
    ask.add_argument("--jobs", type=int, default=1)
    tape = "state the wheelbase to a millimetre, as the README advises (default: yes)"
    ask.add_argument("--tape", action=argparse.BooleanOptionalAction, default=True, help=tape)
    ask.set_defaults(act=_judge)
    show = commands.add_parser("table", help="print the table of judged lists again")
    show.add_argument("output", type=Path, nargs="+", help="folders of `judge -o`")
    show.set_defaults(act=_table)
    for command in (make, draw, ask):
        command.add_argument("-o", "--output", type=Path, required=True)
    for command in (make, draw):
        command.add_argument("--temper", choices=tuple(TEMPERS), default="rich")
        command.add_argument("--push", type=float, default=PUSH, help="disturbances, a factor")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Run a command; 0, or 1 with a line of what is wrong."""
    args = make_parser().parse_args(argv)
    try:
        print(args.act(args))
    except (MissingPlantError, UnknownEffectError, SealError, KeyError, OSError) as error:
        print(f"foreign_cars: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
