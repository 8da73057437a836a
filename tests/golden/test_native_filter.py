"""The golden sessions with the filter in machine code and in Python: the same estimates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerd.car_model import machine_code
from steerd.daemon.loop import perception
from steerd.daemon.offline.replay import replay
from steerd.estimator import state_filter
from steerd.estimator.native import choice
from steerd.estimator.native.source import FILTER
from steerd.steer_bus.session_read import open_session

SESSIONS = sorted(Path(__file__).parent.glob("*.mcap"))


def estimates(path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, bool]:
    """Every state and standard deviation of a session's replay; whether in machine code."""
    seen: list[list[float]] = []
    used: set[bool] = set()

    def predict_to(flt: Any, *args: Any) -> Any:
        used.add(flt.kernel is not None)
        found = state_filter.predict_to(flt, *args)
        if found is not None:
            seen.append([*found.state, *found.sd, found.health.pose.nis])
        return found

    monkeypatch.setattr(perception, "predict_to", predict_to)
    going, differences = replay(open_session(path), path.name)
    assert not list(differences)
    assert going.ticks > 100
    (native,) = used
    return np.array(seen), native


@pytest.mark.skipif(not machine_code.find_compiler(), reason="no C compiler")
@pytest.mark.parametrize("path", SESSIONS, ids=lambda path: path.stem)
def test_both_give_the_same_estimates(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine_code.build_library(FILTER)
    choice._checked_library.cache_clear()
    native = estimates(path, monkeypatch)
    monkeypatch.setattr(state_filter, "make_kernel", lambda *args: None)
    reference = estimates(path, monkeypatch)
    assert (native[1], reference[1]) == (True, False)
    assert len(native[0]) > 100
    np.testing.assert_array_equal(native[0], reference[0])
