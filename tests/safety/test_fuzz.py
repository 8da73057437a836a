"""A share of the fuzzing in every run: seeded damage to good inputs; `fuzz.py` is the long form."""

import pytest

from tests.safety.fuzz import find_failure
from tests.safety.fuzz_targets import BOOT, TARGETS, make_file, request_seeds

RUNS = {"session": 300}


@pytest.mark.parametrize("name", TARGETS)
def test_good_inputs_pass_and_nothing_damaged_raises_what_it_must_not(name: str) -> None:
    target = TARGETS[name]
    for data in target.seeds():
        target.check(data)
    assert find_failure(target.check, target.seeds(), RUNS.get(name, 1500), seed=1) is None


def test_a_target_that_breaks_is_found_out() -> None:
    def check(data: bytes) -> None:
        if BOOT.to_bytes(8, "little") not in data:
            raise IndexError("a decoder that trusts its input")

    seeds = [data for data in request_seeds() if BOOT.to_bytes(8, "little") in data]
    found = find_failure(check, seeds, 1000, seed=0)
    assert found is not None
    assert isinstance(found[1], IndexError)


def test_pieces_make_a_session_with_right_checksums() -> None:
    loose = TARGETS["session"].seeds()[2]
    assert make_file(loose).count(b"\x89MCAP0\r\n") == 2
