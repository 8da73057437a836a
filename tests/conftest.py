"""Options of the whole suite."""

# Why: docs/decisions/rooms-and-code.md#d37

from collections import Counter
from collections.abc import Iterator

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--update-golden`: drive the golden sessions again, and show what changes."""
    parser.addoption("--update-golden", action="store_true", help="record golden sessions anew")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List what `--reruns` ran again, each with its first failure: a flaky test is no secret."""
    first: dict[str, pytest.TestReport] = {}
    counts: Counter[str] = Counter()
    for report in terminalreporter.getreports("rerun"):
        first.setdefault(report.nodeid, report)
        counts[report.nodeid] += 1
    if not first:
        return
    terminalreporter.section("failed and run again: the first failure of each", yellow=True)
    for name, report in first.items():
        terminalreporter.line(f"{name} (failed {counts[name]} x before its last run)", bold=True)
        terminalreporter.line(report.longreprtext)


@pytest.fixture(autouse=True, scope="session")
def home_of_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is recorded without a name, and what was written, stays out of the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
