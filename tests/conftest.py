"""Options of the whole suite."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--update-golden`: drive the golden sessions again, and show what changes."""
    parser.addoption("--update-golden", action="store_true", help="record golden sessions anew")
