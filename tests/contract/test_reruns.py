"""`--reruns` hides nothing: what failed at first is listed at the end, with its reason."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CONFTEST = Path(__file__).parents[1] / "conftest.py"
SUITE = """
import pytest

RUNS = []

def test_steady():
    pass

@pytest.mark.parametrize("k", range(5))
def test_many(k):
    RUNS.append(1)
    assert len(RUNS) % 2 == 0, f"stalled in run {len(RUNS)}"

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
    done = run_suite("--reruns", "2", "-k", "steady or flaky", *workers)
    assert done.returncode == 0, done.stdout
    assert "1 of 2 tests failed at first; 1 may" in done.stdout
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
    assert "0 of 1 tests failed at first; 1 may" in done.stdout


@pytest.mark.parametrize("workers", [(), ("-n", "1")], ids=["alone", "xdist"])
def test_too_many_first_failures_fail_the_run(run_suite, workers):
    done = run_suite("--reruns", "2", "-k", "many", *workers)
    assert "5 of 5 tests failed at first; 1 may" in done.stdout
    assert done.returncode == 1, done.stdout
    allowed = run_suite("--reruns", "2", "-k", "many", "--first-pass-failures", "1.0", *workers)
    assert allowed.returncode == 0, allowed.stdout


def test_without_reruns_nothing_is_counted(run_suite):
    assert "failed at first" not in run_suite("-k", "steady").stdout
