"""Row numbers by name point at what they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.native import windows
from steerd.car_model.native.specialised import Range, specialise
from steerd.car_model.native.threads import WORTHWHILE, share_out
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.tape import TAPE, Tape, program
from tests.property.test_car_model import evaluated, formulas, points

# Equations under bounds of their inputs: the same numbers, fewer operations.


@given(formulas, st.floats(-2.0, 2.0), st.floats(0.0, 3.0), points)
@settings(derandomize=True, deadline=None, max_examples=300)
def test_any_expression_keeps_its_value_within_the_bounds(formula, low, width, point):
    """Random formulas of three inputs, one of them bounded."""
    tape = Tape()
    inputs = [tape.symbol(name) for name in "abc"]
    output = tape.node(evaluated(TAPE, formula, inputs))
    short = specialise([output], {inputs[0].place: Range(low, low + width)})
    before, after = program(inputs, [output]), program(inputs, list(short))
    for a in np.linspace(low, low + width, 5).tolist():
        assert after(a, *point[1:]) == pytest.approx(before(a, *point[1:]), rel=1e-12, abs=1e-12)


# Pieces of compiled work on several threads.


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_every_piece_is_done_once_by_a_worker_with_a_number(monkeypatch, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
    done = []
    share_out(lambda piece, worker: done.append((piece, worker)), 40, WORTHWHILE)
    assert sorted(piece for piece, _ in done) == list(range(40))
    assert {worker for _, worker in done} <= set(range(threads))


def test_short_work_wakes_nobody(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    done = []
    share_out(lambda piece, worker: done.append((piece, worker)), 3, WORTHWHILE // 10)
    assert done == [(0, 0), (1, 0), (2, 0)]


def test_what_fails_in_another_thread_fails_here(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")

    def work(piece: int, _worker: int) -> None:
        raise ZeroDivisionError(piece)

    with pytest.raises(ZeroDivisionError):
        share_out(work, 4, WORTHWHILE)


def test_two_threads_give_the_numbers_of_one(monkeypatch):
    kernels, p, count, steps = windows.make_kernels(), np.array(DEFAULT_CAR), 20, WORTHWHILE
    rng = np.random.default_rng(7)
    rows = np.stack([rng.uniform(-0.2, 0.2, count * steps), np.ones(count * steps)], -1)
    low = steps * np.arange(count)
    blocks = windows.make_window_blocks(np.stack([low, low + steps, low], axis=1), np.zeros(count))
    first = np.zeros((count, 7))
    first[:, 3] = 1.0
    held, found = windows.HeldCommands(rows, 0.005), []
    for threads in (1, 2):
        monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
        path = windows.march(kernels, p, first, held, blocks, steps)
        seen = windows.view_by_window(path, count)
        assert np.shares_memory(seen, path)
        back = windows.march_back(kernels, p, path, seen, held, blocks)
        found.append((seen, back.first, back.commands, back.parameters))
        assert not len(
            windows.march_back(kernels, p, path, seen, held, blocks, commands=False).commands
        )
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
