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


def draw(adapting: bool) -> list[tuple[str, str, bool]]:
    """All cells, or of each fault a third drawn with a seed; with a mistaken learner one."""
    drawn = CELLS
    if ASKED != "all":
        rng, drawn = np.random.default_rng([int(ASKED), adapting]), []
        for code in BY_CODE:
            cells = [cell for cell in CELLS if cell[0] == code]
            count = 1 if adapting else (len(cells) + 2) // 3
            drawn += [cells[k] for k in sorted(rng.choice(len(cells), count, replace=False))]
    return [(*cell, adapting) for cell in drawn]


DRAWN = draw(False) + draw(True)


def test_the_matrix_is_as_large_as_it_says() -> None:
    assert len(FAULT_CASES) >= 72
    assert len(BY_CODE) == len(FAULT_CASES)
    assert len(CELLS) >= 8 * len(FAULT_CASES)
    assert {phase for _, phase, adapting in DRAWN if not adapting} == set(PHASES)
    assert {(code, adapting) for code, _, adapting in DRAWN} == {
        (code, adapting) for code in BY_CODE for adapting in (False, True)
    }


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


def test_a_cell_is_repeatable_to_the_byte() -> None:
    logs = []
    for _ in range(2):
        rig = twin(at_phase("P5"))
        rig.break_it("M14")
        rig.go_on(0.6)
        logs.append(list(rig.run.world.log))
    assert logs[0] == logs[1]


@pytest.mark.parametrize("seed", [1, 2])
def test_nominal_driving_with_loss_and_gaps_is_not_stopped(seed: int) -> None:
    """A short drive of `benchmarks/no_false_stop.py`: lost and late poses stop no car."""
    assert drive_once(seed, 15.0).stopped == ""
