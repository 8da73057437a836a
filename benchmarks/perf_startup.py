"""From the start of a process to its first useful act: wall seconds, some starts each.

`steerd --help`; `steerd run --sim` to the first command to the motor (announced as RUNNING);
`steerd identify` to compiled kernels in memory (its first iteration follows at once) and to its
end. Beside them an interpreter that does nothing, and one that only imports numpy or torch.
"""

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

STEERD = str(Path(sys.executable).with_name("steerd"))
STARTS = 5
DONE = (0, 3, 5)
"""3: a file that is not there. Of `identify`, 5 says no better than the start, and the simulated
car starts as the true one."""
MISSING = {
    "identify": ("identify", "none.mcap"),
    "diagnose": ("diagnose", "none.mcap"),
    "run": ("run", "--sim", "--car", "none.toml"),
    "plot": ("plot", "none.mcap"),
}
"""A command line of each that names a file which is not there."""


def seconds(command: Sequence[str]) -> float:
    began = time.perf_counter()
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
    if done.returncode not in DONE:
        raise RuntimeError(f"{command[:2]} ended with {done.returncode}: {done.stderr.decode()}")
    return time.perf_counter() - began


def until_said(command: Sequence[str], words: Sequence[bytes]) -> float:
    """From start to the first of these words on standard output or error; then it is ended."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout is not None
    heard, fd = b"", process.stdout.fileno()
    while not any(word in heard for word in words):
        if not select.select([fd], [], [], 60.0)[0] or not (data := os.read(fd, 65536)):
            raise RuntimeError(f"{command[:3]} said {heard!r}")
        heard += data
    took = time.perf_counter() - began
    process.terminate()
    process.communicate()
    return took


def spread(values: Sequence[float]) -> dict[str, float]:
    low, *_, high = sorted(values)
    middle = sorted(values)[len(values) // 2]
    return {"median": round(middle, 3), "low": round(low, 3), "high": round(high, 3)}


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        drive = str(Path(folder) / "drive.mcap")
        fast = [STEERD, "run", "--sim", "--fast", "--speed", "1.5", "--duration", "20"]
        seconds([*fast, "--record", drive])
        count = 0

        def live() -> list[str]:
            nonlocal count
            count += 1
            record = str(Path(folder) / f"live{count}.mcap")
            return [STEERD, "run", "--sim", "--auto-arm", "--duration", "60",
                    "--listen", "tcp/127.0.0.1:7561", "--record", record]  # fmt: skip

        identify = [STEERD, "identify", drive, "--out", str(Path(folder) / "car.toml")]
        found = {
            "python -c pass": [seconds([sys.executable, "-c", "pass"]) for _ in range(STARTS)],
            "import numpy": [
                seconds([sys.executable, "-c", "import numpy"]) for _ in range(STARTS)
            ],
            "import torch": [seconds([sys.executable, "-c", "import torch"]) for _ in range(3)],
            "steerd --help": [seconds([STEERD, "--help"]) for _ in range(STARTS)],
            **{
                f"{name}, no such file": [seconds([STEERD, *argv]) for _ in range(STARTS)]
                for name, argv in MISSING.items()
            },
            "run --sim to first command": [until_said(live(), [b"RUNNING"]) for _ in range(3)],
        }
        seconds(identify)  # kernels compiled
        found["identify, kernels ready"] = [
            seconds(
                [
                    sys.executable,
                    "-c",
                    "from steerd.car_model.native.windows import make_kernels; make_kernels()",
                ]
            )
            for _ in range(3)
        ]
        found["identify 20 s of driving, all"] = [seconds(identify) for _ in range(2)]
        print(json.dumps({name: spread(values) for name, values in found.items()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
