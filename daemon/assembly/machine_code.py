"""All machine code, compiled once: `python -m steerd.daemon.assembly.machine_code`.

Nothing needs it: without a compiler everything runs, only slower.
"""

import sys

from steerd.car_model.machine_code import build_library
from steerd.estimator.native.source import FILTER

SOURCES = (FILTER,)


def build_all() -> bool:
    """Compile what is not compiled yet; whether all of it is there."""
    made = [build_library(source) for source in SOURCES]
    return None not in made


def main() -> None:
    """Compile, and say what the filter will run in."""
    made = "machine code" if build_all() else "Python, for want of a C compiler"
    sys.stdout.write(f"the filter runs in {made}\n")


if __name__ == "__main__":
    main()
