"""What healthy drives teach of a base travels beside its car file."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.sysid.inference.knowledge import (
    EDGES,
    EXCESS_MAX,
    Knowledge,
    excess_by_regime,
    knowledge_of_section,
    knowledge_section,
)

NAMES = ("lf", "lr", "steer_gain", "scrub.drag")


def known(seed: int = 0) -> Knowledge:
    root = np.random.default_rng(seed).standard_normal((4, 6)) * [[1e-3], [2e-3], [0.01], [0.3]]
    excess = (1.0, 1.0, 1.2, 1.5, 2.0, 4.0)
    return Knowledge(NAMES, root @ root.T, excess, (0.16, 0.17, 1.01, 0.2))


@pytest.mark.parametrize("seed", range(5))
def test_what_is_known_survives_the_car_file(seed: int) -> None:
    before = known(seed)
    after = knowledge_of_section(knowledge_section(before))
    assert after is not None
    assert after.names == before.names
    assert after.values == before.values
    assert after.excess == before.excess
    sd = np.sqrt(np.diag(before.covariance))
    away = np.abs(after.covariance - before.covariance) / np.outer(sd, sd)
    assert away.max() < 2e-5
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0


@pytest.mark.parametrize("key", ["names", "sd", "correlation", "excess", "values"])
def test_a_damaged_section_is_refused(key: str) -> None:
    table = knowledge_section(known())
    for damaged in ({k: v for k, v in table.items() if k != key}, {**table, key: "?"}):
        with pytest.raises(ValueError, match="knowledge"):
            knowledge_of_section(damaged)
    assert knowledge_of_section({}) is None


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(0.01, 500.0), st.floats(0.0, 12.0)), min_size=1, max_size=60))
def test_excess_is_never_less_than_noise_and_never_falls(rows: list[tuple[float, float]]) -> None:
    ratio, lateral = np.array(rows).T
    found = excess_by_regime(ratio, lateral)
    assert len(found) == len(EDGES) + 1
    assert all(1.0 <= a <= b <= EXCESS_MAX for a, b in itertools.pairwise(found))


def test_excess_is_learnt_where_the_model_fails() -> None:
    lateral = np.concatenate([np.full(20, 0.5), np.full(20, 5.0)])
    ratio = np.concatenate([np.full(20, 1.0), np.full(20, 6.0)])
    found = excess_by_regime(ratio, lateral)
    assert found[0] == pytest.approx(1.0)
    assert found[4] == pytest.approx(6.0)
    assert found[5] > found[4]  # nobody drove so hard: no better than where somebody did
