"""What a process that drives loads of the car model."""

import subprocess
import sys


def test_nothing_that_drives_a_car_imports_torch() -> None:
    code = (
        "import sys, steerd.car_model.linear, steerd.car_model.rollout\n"
        "import steerd.car_model.car_file, steerd.car_model.effects\n"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
