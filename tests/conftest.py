"""Options of the whole suite."""

# Why: docs/decisions/rooms-and-code.md#d37

import resource
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import settings

# A machine that stalls for a second is no failure of what is tested.
settings.register_profile("no wall clock", deadline=None)
settings.load_profile("no wall clock")

FIRST_PASS_FAILURES = 0.1
"""Share of the tests that may fail at first, on a machine that stalls; one always may."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--update-golden` drives golden sessions again; the other bounds what `--reruns` hides."""
    parser.addoption("--update-golden", action="store_true", help="record golden sessions anew")
    parser.addoption(
        "--first-pass-failures", type=float, default=FIRST_PASS_FAILURES, metavar="SHARE",
        help="fail if a larger share of the tests failed before a rerun passed",
    )  # fmt: skip


def count_first_failures(config: pytest.Config) -> tuple[int, int]:
    """Tests that failed at first, and tests that ran."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:
        return 0, 0
    failed = {report.nodeid for report in reporter.getreports("rerun")}
    ended = ("passed", "failed")
    ran = {r.nodeid for name in ended for r in reporter.getreports(name) if r.when == "call"}
    return len(failed), len(ran | failed)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run in which too many tests needed another try: that is no busy machine."""
    failed, ran = count_first_failures(session.config)
    allowed = session.config.getoption("--first-pass-failures")
    if failed > max(1, allowed * ran) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List what `--reruns` ran again, each with its first failure: a flaky test is no secret."""
    reports: dict[str, list[pytest.TestReport]] = {}
    for report in terminalreporter.getreports("rerun"):
        reports.setdefault(report.nodeid, []).append(report)
    failed, ran = count_first_failures(terminalreporter.config)
    if terminalreporter.config.getoption("reruns", 0):
        allowed = terminalreporter.config.getoption("--first-pass-failures")
        terminalreporter.section("first pass")
        terminalreporter.line(
            f"{failed} of {ran} tests failed at first; {max(1, int(allowed * ran))} may"
        )
    if reports:
        terminalreporter.section("failed and run again: the first failure of each", yellow=True)
    for name, each in reports.items():
        terminalreporter.line(f"{name} (failed {len(each)} x before its last run)", bold=True)
        terminalreporter.line(each[0].longreprtext)


@pytest.fixture(autouse=True, scope="session")
def home_of_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is recorded without a name, and what was written, stays out of the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Type a command that ends with a code, 0 unless another is given: what it says, by stream."""
    from steerd.daemon.cli.main import run_cli

    def run(*words: object, code: int = 0) -> Any:
        capsys.readouterr()
        ended = run_cli([str(word) for word in words])
        said = capsys.readouterr()
        assert ended == code, said.err
        return said

    return run


@pytest.fixture
def room_for() -> Iterator[Callable[..., None]]:
    """Let no file grow beyond so many bytes, as `ulimit -f` does; it needs no rights."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size: int | None = None) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft if size is None else size, hard))

    yield limit
    limit()
