"""The generated Jacobian: what the equations give today, exact, fast to load."""

import subprocess
import sys

import pytest
import sympy

from car_model.generate import TARGET, generated_text


def test_the_committed_file_is_what_the_equations_give() -> None:
    committed = TARGET.read_text(encoding="utf-8")
    if f"(SymPy {sympy.__version__})" not in committed:
        pytest.skip("another SymPy release may print the same formulas differently")
    assert generated_text() == committed


def test_nothing_that_drives_a_car_imports_sympy_or_torch() -> None:
    code = (
        "import sys, car_model.linear, car_model.rollout, car_model.car_file, car_model.effects\n"
        "sys.exit(any(m in sys.modules for m in ('sympy', 'torch', 'numba')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
