"""`--reruns` hides nothing: what failed at first is listed at the end, with its reason."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CONFTEST = Path(__file__).parents[1] / "conftest.py"
SUITE = """
RUNS = []

def test_steady():
    pass

def test_flaky():
    RUNS.append(1)
    assert len(RUNS) > 2, f"stalled in run {len(RUNS)}"
"""


@pytest.fixture
def run_suite(tmp_path):
    shutil.copy(CONFTEST, tmp_path / "conftest.py")
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "test_suite.py").write_text(SUITE)

    def run(*arguments):
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    return run


@pytest.mark.parametrize("workers", [(), ("-n", "1")], ids=["alone", "xdist"])
def test_a_test_that_passes_at_last_is_listed_with_its_first_failure(run_suite, workers):
    done = run_suite("--reruns", "2", *workers)
    assert done.returncode == 0, done.stdout
    _, mark, summary = done.stdout.partition("failed and run again")
    assert mark, done.stdout
    assert "test_suite.py::test_flaky (failed 2 x before its last run)" in summary
    assert "stalled in run 1" in summary
    assert "stalled in run 2" not in summary
    assert "test_steady" not in summary


def test_nothing_is_listed_where_nothing_was_run_again(run_suite):
    done = run_suite("--reruns", "2", "-k", "steady")
    assert done.returncode == 0, done.stdout
    assert "run again" not in done.stdout
