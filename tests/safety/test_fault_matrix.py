"""Every fault in every phase, in virtual time, judged on the simulated VESC's bytes."""

import os
from itertools import product

import numpy as np
import pytest

from benchmarks.no_false_stop import drive_once
from steerd.daemon.loop.transitions import SupervisorState
from tests.safety.catalogue import BY_CODE, FAULT_CASES
from tests.safety.matrix import MOVING, list_cells, run_cell
from tests.safety.rig import PHASES, at_phase, twin

CELLS = list_cells()
ASKED = os.environ.get("STEERD_FAULTS", "0")
PARKED, STEERED = set(PHASES) - set(MOVING), ("P4", "P5", "P6")


def draw(adapting: bool) -> list[tuple[str, str, bool]]:
    """All cells, or of each fault two drawn with a seed: before the car drives, and since.

    With a mistaken learner one, in a phase in which its design steers, of each fault of poses and
    car; of the others, which know no design, a third.
    """
    drawn = CELLS
    if ASKED != "all":
        rng, drawn = np.random.default_rng([int(ASKED), adapting]), []
        codes = [c for k, c in enumerate(BY_CODE) if not adapting or c[0] in "MC" or k % 3 == 0]
        for code, part in product(codes, [STEERED] if adapting else [PARKED, MOVING]):
            drawn.append(
                rng.choice([cell for cell in CELLS if cell[0] == code and cell[1] in part])
            )
    return [(*map(str, cell), adapting) for cell in drawn]


DRAWN = draw(False) + draw(True)


def test_the_matrix_is_as_large_as_it_says() -> None:
    assert len(FAULT_CASES) >= 72
    assert len(BY_CODE) == len(FAULT_CASES)
    assert len(CELLS) >= 8 * len(FAULT_CASES)
    assert {phase for _, phase, adapting in DRAWN if not adapting} == set(PHASES)
    assert {code for code, _, adapting in DRAWN if not adapting} == set(BY_CODE)
    assert {phase for _, phase, adapting in DRAWN if adapting} >= set(STEERED)


@pytest.mark.parametrize(("code", "phase", "adapting"), DRAWN)
def test_cell(code: str, phase: str, adapting: bool) -> None:
    outcome = run_cell(BY_CODE[code], phase, adapting=adapting)
    assert not outcome.wrong, outcome


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


@pytest.mark.parametrize("seed", [1, 2])
def test_nominal_driving_with_loss_and_gaps_is_not_stopped(seed: int) -> None:
    """A short drive of `benchmarks/no_false_stop.py`: lost and late poses stop no car."""
    assert drive_once(seed, 15.0).stopped == ""
