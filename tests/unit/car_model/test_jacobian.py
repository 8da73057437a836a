"""The generated Jacobian: what the equations give today, exact, fast to load."""

import subprocess
import sys

from steerd.car_model.generate import TARGET, generated_text


def test_the_committed_file_is_what_the_equations_give() -> None:
    assert generated_text() == TARGET.read_text(encoding="utf-8")


def test_nothing_that_drives_a_car_imports_torch() -> None:
    code = (
        "import sys, steerd.car_model.linear, steerd.car_model.rollout\n"
        "import steerd.car_model.car_file, steerd.car_model.effects\n"
        "sys.exit(any(m in sys.modules for m in ('torch', 'numba')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
