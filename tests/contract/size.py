"""How large each room is against its goal: `make size`.

A room may not grow: `sizes.json` holds the lines that were recorded last, and
`python -m tests.contract.size --record` writes smaller ones only.
"""

import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
RECORD = Path(__file__).with_name("sizes.json")
GOALS: dict[str, tuple[tuple[str, ...], int]] = {
    "car_model": (("car_model",), 5500),
    "sysid": (("sysid",), 4500),
    "sim_gap": (("sim_gap",), 4500),
    "estimator, controller": (("estimator", "controller"), 2800),
    "steer_bus": (("steer_bus",), 2800),
    "vesc_link": (("vesc_link",), 2200),
    "mocap_link": (("mocap_link",), 2800),
    "sim_hw": (("sim_hw",), 2600),
    "daemon: loop, process, ipc, offline": (
        ("daemon/loop", "daemon/process", "daemon/ipc", "daemon/offline"), 7500),
    "daemon": (("daemon",), 17500),
    "product": (("car_model", "controller", "daemon", "estimator", "mocap_link", "sim_gap",
                 "sim_hw", "steer_bus", "steerd", "sysid", "vesc_link"), 45000),
    "tests": (("tests",), 30000),
}  # fmt: skip
"""Folders of each room and the most lines of Python that it may have, blanks and comments in."""
ROOMS = [name for name in GOALS["product"][0] if name != "steerd"]


def list_files(folders: Iterable[str], endings: tuple[str, ...]) -> list[str]:
    """Files that git tracks below some folders, as paths from the root."""
    listing = ["git", "ls-files", "-z", "--", *folders]
    done = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=True)
    names = done.stdout.split("\0")
    return [name for name in names if name.endswith(endings) and (ROOT / name).is_file()]


def count_lines(folders: Iterable[str]) -> int:
    """Lines of the Python files below some folders."""
    return sum(len((ROOT / f).read_bytes().splitlines()) for f in list_files(folders, (".py",)))


def sizes() -> dict[str, int]:
    return {room: count_lines(folders) for room, (folders, _) in GOALS.items()}


def recorded() -> dict[str, int]:
    return dict(json.loads(RECORD.read_text()))


def main(words: list[str]) -> int:
    """Print the table; with `--record`, keep what is smaller than recorded."""
    now, before = sizes(), recorded()
    print(f"{'room':38}{'now':>8}{'recorded':>10}{'goal':>8}")
    for room, lines in now.items():
        print(f"{room:38}{lines:8}{before.get(room, lines):10}{GOALS[room][1]:8}")
    if "--record" in words:
        kept = {room: min(lines, before.get(room, lines)) for room, lines in now.items()}
        RECORD.write_text(json.dumps(kept, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
