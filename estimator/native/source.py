"""What the filter's machine code is made from."""

from pathlib import Path

from steerd.car_model.machine_code import Source

FILTER = Source("filter", Path(__file__).parent, ("filter.c", "equations.h"))
