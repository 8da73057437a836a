"""Fuzz what reads foreign bytes: `python -m tests.safety.fuzz [TARGET…] --runs 1000000`.

With atheris (`pip install --group fuzz`) libFuzzer looks for inputs that reach new code; without,
or with `--blind`, good inputs are damaged at random. Either way an input that raises what it must
not is written to `crash-TARGET` and ends the run with exit code 1. The targets and what they
demand are in `fuzz_targets.py`; a share of this runs in the tests.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

ROOMS = ["vesc_link", "mocap_link", "steer_bus", "daemon"]
LIES = (0, 1, 3, 0x7F, 0x80, 0xFF, 0x100, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF)
MAX_INPUT = 4096


def damage(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    """A good input with one to four things wrong: bits, bytes, lengths, cuts, splices, repeats."""
    for _ in range(rng.integers(1, 5)):
        data = data or b"\0"
        at = int(rng.integers(len(data)))
        end = min(len(data), at + int(rng.integers(1, 40)))
        match rng.integers(7):
            case 0:
                data = data[:at] + bytes((data[at] ^ 1 << rng.integers(8),)) + data[at + 1 :]
            case 1:
                data = data[:at] + rng.bytes(end - at) + data[end:]
            case 2:
                size = int(rng.choice((1, 2, 4, 8)))
                lie = LIES[rng.integers(len(LIES))].to_bytes(8, rng.choice(("little", "big")))
                data = data[:at] + lie[:size] + data[at + size :]
            case 3:
                data = data[:at]
            case 4:
                data = data[:at] + other[int(rng.integers(len(other) or 1)) :]
            case 5:
                data = data[:end] + data[at:end] + data[end:]
            case _:
                data = data[:at] + data[end:]
    return data[:MAX_INPUT]


def find_failure(
    check: Callable[[bytes], None], seeds: list[bytes], runs: int, seed: int
) -> tuple[bytes, Exception] | None:
    """Check damaged inputs; the first that fails, and how."""
    rng = np.random.default_rng(seed)
    for k in range(runs):
        one, other = (seeds[i] for i in rng.integers(len(seeds), size=2))
        data = one if k < len(seeds) else damage(rng, one, other)
        try:
            check(data)
        except Exception as error:
            return data, error
    return None


def fuzz_blind(name: str, runs: int, seed: int) -> int:
    """Damage good inputs at random; 1 if one of them fails."""
    from tests.safety.fuzz_targets import TARGETS

    target, began = TARGETS[name], time.process_time()
    failure = find_failure(target.check, target.seeds(), runs, seed)
    took = time.process_time() - began
    if failure is not None:
        Path(f"crash-{name}").write_bytes(failure[0])
    result = {"target": name, "how": "damage", "runs": runs, "cpu_s": round(took, 1)}
    print(json.dumps(result | {"failure": repr(failure[1]) if failure else None}), flush=True)
    return int(failure is not None)


def fuzz_guided(name: str, runs: int, seed: int) -> None:
    """Let libFuzzer look for inputs that reach new code; never returns."""
    import atheris  # type: ignore[import-not-found,unused-ignore]

    with atheris.instrument_imports(include=ROOMS):
        from tests.safety.fuzz_targets import TARGETS
    target = TARGETS[name]
    with tempfile.TemporaryDirectory() as folder:
        for k, data in enumerate(target.seeds()):
            (Path(folder) / f"{k}").write_bytes(data)
        options = (f"-runs={runs}", f"-seed={seed + 1}", f"-max_len={MAX_INPUT}", "-timeout=10")
        more = ("-rss_limit_mb=2048", f"-artifact_prefix=crash-{name}-", "-print_final_stats=1")
        atheris.Setup([sys.argv[0], *options, *more, folder], target.check)
        atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", help="names in fuzz_targets.py (default: all)")
    parser.add_argument("--runs", type=int, default=100_000, help="inputs a target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--blind", action="store_true", help="do not use atheris")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    guided = find_spec("atheris") is not None and not args.blind
    if args.here:
        fuzz_guided(args.targets[0], args.runs, args.seed)
    from tests.safety.fuzz_targets import TARGETS

    failed = 0
    for name in args.targets or TARGETS:
        if not guided:
            failed |= fuzz_blind(name, args.runs, args.seed)
            continue
        options = [name, "--here", "--runs", str(args.runs), "--seed", str(args.seed)]
        command = [sys.executable, "-m", "tests.safety.fuzz", *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = [line for line in done.stderr.splitlines() if "DONE" in line or "Done" in line]
        print(name, *(lines if done.returncode == 0 else [done.stderr[-3000:]]), sep="\n  ")
        failed |= int(done.returncode != 0)
    return failed


if __name__ == "__main__":
    sys.exit(main())
