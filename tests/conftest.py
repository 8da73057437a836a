"""Options of the whole suite."""

from collections.abc import Iterator

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--update-golden`: drive the golden sessions again, and show what changes."""
    parser.addoption("--update-golden", action="store_true", help="record golden sessions anew")


@pytest.fixture(autouse=True, scope="session")
def home_of_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is recorded without a name stays out of the user's own sessions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        yield
