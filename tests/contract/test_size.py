"""No room grows."""

import subprocess

import pytest

from tests.contract.size import GOALS, recorded, sizes


def test_no_room_is_larger_than_recorded() -> None:
    try:
        now = sizes()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout: what belongs to a room cannot be listed")
    larger = {r: (now[r], most) for r, most in recorded().items() if now[r] > most}
    assert not larger, f"(lines, recorded) {larger}: a change that adds lines takes as many away"


def test_every_room_has_a_recorded_size() -> None:
    assert set(recorded()) == set(GOALS)
