"""Every fault in every phase, in virtual time, judged on the simulated VESC's bytes.

A seeded third runs by default (every fault and every phase is in it), all of them with
``STEERD_FAULTS=all`` (`make safety`); any other value is the seed.
"""

import os

import numpy as np
import pytest

from tests.safety.catalogue import BY_CODE, FAULT_CASES
from tests.safety.matrix import list_cells, run_cell
from tests.safety.rig import PHASES, at_phase, twin

CELLS = list_cells()
ASKED = os.environ.get("STEERD_FAULTS", "0")


def chosen() -> list[tuple[str, str]]:
    """All cells, or a third of them drawn with a seed: each fault and each phase is in it."""
    if ASKED == "all":
        return CELLS
    rng = np.random.default_rng(int(ASKED))
    by_fault = [
        [cell for cell in CELLS if cell[0] == fault_case.code] for fault_case in FAULT_CASES
    ]
    return [
        cells[k]
        for cells in by_fault
        for k in sorted(rng.choice(len(cells), (len(cells) + 2) // 3, replace=False))
    ]


def test_the_matrix_is_as_large_as_it_says() -> None:
    assert len(FAULT_CASES) >= 72
    assert len({fault_case.code for fault_case in FAULT_CASES}) == len(FAULT_CASES)
    assert len(CELLS) >= 8 * len(FAULT_CASES)
    assert {phase for _, phase in chosen()} == set(PHASES)
    assert {code for code, _ in chosen()} == set(BY_CODE)


@pytest.mark.parametrize(("code", "phase"), chosen())
def test_cell(code: str, phase: str) -> None:
    outcome = run_cell(BY_CODE[code], phase)
    assert not outcome.wrong, outcome


def test_a_cell_is_repeatable_to_the_byte() -> None:
    logs = []
    for _ in range(2):
        rig = twin(at_phase("P5"))
        rig.break_it("M14")
        for _ in range(60):
            rig.step()
        logs.append(list(rig.run.world.log.entries))
    assert logs[0] == logs[1]
