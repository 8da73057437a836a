"""Command line: `python -m benchmarks.blind_gap generate | run | open | score | detectability`."""

import argparse
import sys
from pathlib import Path

from benchmarks.blind_gap.bank import CARS, SETS
from benchmarks.blind_gap.detectability import FILE, save_severities
from benchmarks.blind_gap.diagnosing import DIAGNOSE, IDENTIFY, diagnose_set
from benchmarks.blind_gap.generate import generate, key_path
from benchmarks.blind_gap.report import write_report
from benchmarks.blind_gap.score import CONFIDENT, score
from benchmarks.blind_gap.seal import SealError
from benchmarks.blind_gap.unsealing import LOG, OpeningError, case_names, load_labels, load_manifest
from benchmarks.blind_gap.unsealing import open_labels as unseal_labels
from benchmarks.blind_gap.verdicts import VerdictError, load_verdicts, with_own

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "results" / "blind-test.md"


def _generate(args: argparse.Namespace) -> str:
    blocks = tuple(args.blocks.split(",")) if args.blocks else ()
    whole = tuple(args.whole.split(",")) if args.whole else ()
    generate(args.set, args.out, args.limit, args.nonce, args.jobs, blocks, args.cars, whole)
    sealed = args.out / "labels.sealed.sha256"
    if not sealed.exists():
        return f"{args.out}: cases with open labels, to tune on"
    return f"publish this first: {sealed.read_text().strip()}\nthe key is {key_path(args.out)}"


def _run(args: argparse.Namespace) -> str:
    diagnose_set(args.out, args.verdicts, args.identify, args.diagnose)
    return f"verdicts are in {args.verdicts}; `open` the labels when all are there"


def _open(args: argparse.Namespace) -> str:
    labels = unseal_labels(args.out, args.verdicts, args.key, args.log, args.allow_missing)
    return f"{len(labels['cases'])} labels opened; this opening is in the log"


def _score(args: argparse.Namespace) -> str:
    labels, openings = load_labels(args.out, args.verdicts, args.log)
    manifest = load_manifest(args.out)
    bases = {row["case"]: row["base"] for row in manifest["cases"]}
    verdicts = with_own(load_verdicts(args.verdicts, case_names(manifest)), args.verdicts, bases)
    scores = score(labels["cases"], verdicts)
    notes = [
        f"Set `{labels['set']}`, nonce {labels['nonce']}, limit {labels['limit']},"
        f" blocks {labels['blocks'] or 'all'}, cars {labels.get('cars', CARS)},"
        f" whole {labels.get('whole') or 'none'}: generates again with these.",
        f"Report sets were opened {len(openings)} times so far"
        " (`benchmarks/blind_gap/opened.jsonl`).",
        f"A name is confident from {CONFIDENT} on; names and sets are given detection.",
    ]
    title = "The blind test" if labels["set"] == "report" else "The blind test, on tuning seeds"
    write_report(scores, args.page, title, notes)
    return f"wrote {args.page}"


def _detectability(args: argparse.Namespace) -> str:
    save_severities(args.output)
    return f"wrote {args.output}"


def make_parser() -> argparse.ArgumentParser:
    """The commands and their options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind_gap", description=__doc__)
    commands = parser.add_subparsers(required=True)
    make = commands.add_parser("generate", help="write a set's sessions and sealed labels")
    make.add_argument("--set", choices=SETS, required=True)
    make.add_argument("--out", type=Path, required=True, help="folder that does not exist yet")
    make.add_argument("--limit", type=int, help="cases; every block keeps its share")
    make.add_argument("--blocks", help="only these, by first letters: null,single-rich")
    make.add_argument("--whole", help="these are kept whole, whatever the limit: null")
    make.add_argument("--nonce", type=int, help="make the same set again")
    make.add_argument("--jobs", type=int, default=1)
    make.add_argument("--cars", type=int, default=CARS, help=f"at most {CARS}")
    make.set_defaults(act=_generate)
    ask = commands.add_parser("run", help="identify every car, diagnose every case")
    ask.add_argument("--identify", default=IDENTIFY, help=IDENTIFY)
    ask.add_argument("--diagnose", default=DIAGNOSE, help=DIAGNOSE)
    ask.set_defaults(act=_run)
    unseal = commands.add_parser("open", help="unseal the labels, once the verdicts are written")
    unseal.add_argument("--key", type=Path, help="by default OUT.key")
    unseal.add_argument("--allow-missing", action="store_true")
    unseal.set_defaults(act=_open)
    rate = commands.add_parser("score", help="write the report")
    rate.add_argument("--page", type=Path, default=_PAGE)
    rate.set_defaults(act=_score)
    for command in (ask, unseal, rate):
        command.add_argument("--out", type=Path, required=True, help="the set")
        command.add_argument("--verdicts", type=Path, required=True, help="folder of verdicts")
    for command in (unseal, rate):
        command.add_argument("--log", type=Path, default=LOG, help="of the openings")
    measure = commands.add_parser("detectability", help="measure the table of severities again")
    measure.add_argument("--output", type=Path, default=FILE)
    measure.set_defaults(act=_detectability)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Run a command; 0, or 1 with a line of what is wrong."""
    args = make_parser().parse_args(argv)
    try:
        print(args.act(args))
    except (OpeningError, SealError, VerdictError, OSError) as error:
        print(f"blind_gap: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
