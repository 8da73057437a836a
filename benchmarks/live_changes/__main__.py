"""What the learner notices and names, in virtual time: one row a drive.

python -m benchmarks.live_changes --seeds 20 rows.jsonl
python -m benchmarks.live_changes --cars 20 --minutes 30 quiet.jsonl    # no change at all
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from benchmarks.live_changes.plant import CHANGES
from benchmarks.live_changes.table import describe
from benchmarks.live_changes.trial import follow_drive, trials

QUIET = 600.0
"""Length of a drive without a change [s]."""
_QUIET_SEEDS = 1000


def main() -> None:
    """Drive what has no row yet, and print the table of all rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", type=Path, help="one line a drive; a broken run goes on")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--changes", nargs="*", default=list(CHANGES))
    parser.add_argument("--cars", type=int, default=0, help="drive so many without a change")
    parser.add_argument("--minutes", type=float, default=30.0, help="each of them")
    args = parser.parse_args()
    if args.cars:
        drives = round(args.minutes * 60.0 / QUIET)
        wanted = [(_QUIET_SEEDS + n, "") for n in range(args.cars * drives)]
    else:
        wanted = list(trials(args.seeds, args.changes))
    rows = read_rows(args.rows)
    done = {(row["seed"], row["change"]) for row in rows}
    with args.rows.open("a") as file:
        for seed, name in wanted:
            if (seed, name) not in done:
                row = {"seed": seed, "change": name, **asdict(follow_drive(seed, name, QUIET))}
                file.write(json.dumps(row) + "\n")
                file.flush()
    print(describe(read_rows(args.rows)))


def read_rows(path: Path) -> list[dict[str, object]]:
    """Rows written so far."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


if __name__ == "__main__":
    main()
