"""`make bench`: every measurement, one after the other, then docs/results/performance.md.

    python -m benchmarks.run [--only NAME ...] [--render]

Each piece is a process of its own that prints JSON; what it said is kept in
docs/results/performance.json, so that a piece can be measured again alone (`--only`) and the page
be written again without measuring (`--render`).
"""

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.page import render

ROOT = Path(__file__).parents[1]
DATA, PAGE, FIGURE = (
    ROOT / "docs" / "results" / name
    for name in ("performance.json", "performance.md", "performance-growth.svg")
)
PIECES: dict[str, tuple[str, ...]] = {
    "simulation": ("perf_simulation", "--figure", str(FIGURE)),
    "identify": ("perf_identify",),
    "diagnosis": ("perf_diagnosis",),
    "control_path": ("control_path", "--seconds", "6"),
    "control_floor": ("control_floor",),
    "virtual": ("perf_virtual",),
    "ratio": ("perf_ratio",),
    "wire": ("perf_wire",),
    "startup": ("perf_startup",),
    "batch": ("perf_batch",),
    "hours": ("perf_hours",),
}


def describe_machine() -> dict[str, Any]:
    """What a reader needs to place the figures."""
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    names = [line.split(":")[1].strip() for line in text.splitlines() if "model name" in line]
    return {
        "cpu": names[0] if names else platform.machine(),
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "load": round(os.getloadavg()[0], 2),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
    }


def measure(name: str) -> dict[str, Any]:
    """Run a piece; its last lines of JSON, or why there are none."""
    module, *rest = PIECES[name]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{module}", *rest],
        stdout=subprocess.PIPE, cwd=ROOT, env=environment, text=True, check=False,
    )  # fmt: skip
    took = round(time.perf_counter() - began, 1)
    said = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    print(f"{name}: {took} s", file=sys.stderr)
    if done.returncode or not said:
        return {"failed": f"benchmarks.{module} ended with code {done.returncode}", "took_s": took}
    return {"said": said if len(said) > 1 else said[0], "took_s": took}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=list(PIECES), default=list(PIECES))
    parser.add_argument("--render", action="store_true", help="write the page from what is kept")
    args = parser.parse_args()
    kept: dict[str, Any] = json.loads(DATA.read_text("utf-8")) if DATA.exists() else {}
    if not args.render:
        kept["machine"] = describe_machine()
        for name in args.only:
            kept[name] = measure(name)
            DATA.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(render(kept), encoding="utf-8")
    failed = [name for name in PIECES if "failed" in kept.get(name, {})]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
