"""What is said of a car file that a command has written."""

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from steerd.car_model.car_file import CarFile


def report_refusal(car: "CarFile") -> None:
    """One note where `steerd run` would refuse the file, so that nobody learns it at the car."""
    from steerd.daemon.assembly.car_check import find_refusal
    from steerd.daemon.common.screen import print_labelled

    refusal = find_refusal(car)
    if refusal is not None:
        text = f"`steerd run` refuses this file: {refusal.what}\n{refusal.hint}".rstrip()
        print_labelled("note: ", text, sys.stderr)
