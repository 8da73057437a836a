"""Every fault in every phase, in virtual time, judged on the simulated VESC's bytes."""

import os

import numpy as np
import pytest

from benchmarks.no_false_stop import drive_once
from steerd.daemon.loop.transitions import SupervisorState
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


def chosen_adapting() -> list[tuple[str, str]]:
    """All cells, or one of each fault."""
    if ASKED == "all":
        return CELLS
    rng = np.random.default_rng([int(ASKED), 1])
    drawn = []
    for fault_case in FAULT_CASES:
        cells = [cell for cell in CELLS if cell[0] == fault_case.code]
        drawn.append(cells[int(rng.integers(len(cells)))])
    return drawn


@pytest.mark.parametrize("phase", ["P5", "P6"])
def test_the_mistaken_learner_is_followed(phase: str) -> None:
    rig = twin(at_phase(phase, True))
    assert rig.proposed >= 2
    assert rig.run.core.designs.refused == 0
    numbers = set()
    for _ in range(300):
        rig.step()
        numbers.add(rig.run.core.loop.adapting.number)
    assert 0 in numbers
    assert len(numbers) >= 3
    assert rig.state is SupervisorState.RUNNING


@pytest.mark.parametrize(("code", "phase"), chosen_adapting())
def test_cell_with_a_mistaken_learner(code: str, phase: str) -> None:
    outcome = run_cell(BY_CODE[code], phase, adapting=True)
    assert not outcome.wrong, outcome


def test_a_cell_is_repeatable_to_the_byte() -> None:
    logs = []
    for _ in range(2):
        rig = twin(at_phase("P5"))
        rig.break_it("M14")
        for _ in range(60):
            rig.step()
        logs.append(list(rig.run.world.log))
    assert logs[0] == logs[1]


# A short drive of `benchmarks/no_false_stop.py`: lost and late poses stop no car.


@pytest.mark.parametrize("seed", [1, 2])
def test_nominal_driving_with_loss_and_gaps_is_not_stopped(seed: int) -> None:
    assert drive_once(seed, 15.0).stopped == ""
