"""Whoever drives goes: from that moment to the first slower order on the serial wire.

    python -m benchmarks.hands --trials 5 --log hands.jsonl

The cells of `live_faults.py` in which a page or a gamepad drives at 1 m/s, and then is killed,
frozen, closed or silent: real processes, in real time. Each trial is one line of the log; the same
command again goes on where it ended.
"""

import argparse
import json
import statistics
from collections import defaultdict
from pathlib import Path

from tests.safety.live_faults import FAULTS, run_live
from tests.safety.live_hands import held_by_gamepad, held_by_page

HANDS = [name for name, f in FAULTS.items() if f.start in (held_by_page, held_by_gamepad)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=5, help="of each way")
    parser.add_argument("--log", type=Path, default=Path("hands.jsonl"), help="one line a trial")
    args = parser.parse_args()
    took: dict[str, list[float]] = defaultdict(list)
    if args.log.exists():
        for line in args.log.read_text(encoding="ascii").splitlines():
            row = json.loads(line)
            took[row["name"]].append(row["ms"])
    for name in HANDS:
        while len(took[name]) < args.trials:
            outcome = run_live(name, "P5")
            if outcome.wrong:  # on a busy machine a late tick ends the drive; it is driven again
                print(name, *outcome.wrong, sep="\n  ")
                continue
            took[name].append(outcome.stop_ms)
            with args.log.open("a", encoding="ascii") as file:
                file.write(json.dumps({"name": name, "ms": outcome.stop_ms}) + "\n")
        middle, worst = statistics.median(took[name]), max(took[name])
        print(f"{name:20}{middle:6.0f} {worst:6.0f} ms of {len(took[name])}", flush=True)


if __name__ == "__main__":
    main()
