"""Row numbers by name point at what they say."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.native import windows
from steerd.car_model.native.specialised import Range, specialise
from steerd.car_model.native.threads import WORTHWHILE, share_out
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.tape import TAPE, Tape, program

# Equations under bounds of their inputs: the same numbers, fewer operations.

OPS = ("add", "sub", "mul", "min", "max", "select", "neg")


@given(st.integers(0, 10**6), st.floats(-2.0, 2.0), st.floats(0.0, 3.0))
@settings(derandomize=True, deadline=None, max_examples=150)
def test_any_expression_keeps_its_value_within_the_bounds(seed, low, width):
    """Random expressions of three inputs, one of them bounded."""
    rng, tape = np.random.default_rng(seed), Tape()
    inputs = [tape.symbol(name) for name in "abc"]
    nodes = [*inputs, tape.constant(0.5), tape.constant(-1.0)]
    choices = {"min": TAPE.minimum, "max": TAPE.maximum, "select": TAPE.where_positive}
    for _ in range(12):
        op = OPS[rng.integers(len(OPS))]
        a, b, c = (nodes[i] for i in rng.integers(len(nodes), size=3))
        plain = {"add": lambda x, y: x + y, "sub": lambda x, y: x - y, "mul": lambda x, y: x * y}
        if op == "neg":
            nodes.append(-a)
        elif op == "select":
            nodes.append(choices[op](a, b, c))
        else:
            nodes.append((plain.get(op) or choices[op])(a, b))
    outputs = nodes[-4:]
    short = specialise(outputs, {inputs[0].place: Range(low, low + width)})
    before, after = (program(inputs, list(each)) for each in (outputs, short))
    for a in np.linspace(low, low + width, 5):
        numbers = [float(a), *rng.normal(size=2).tolist()]
        got, wanted = after(*numbers), before(*numbers)
        assert all(
            math.isclose(x, y, rel_tol=1e-12, abs_tol=1e-12)
            for x, y in zip(got, wanted, strict=True)
        )


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
