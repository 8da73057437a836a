"""Pieces of compiled work on several threads."""

import numpy as np
import pytest

from steerd.car_model.native.threads import WORTHWHILE, share_out
from steerd.car_model.native.windows import (
    HeldCommands,
    make_kernels,
    make_window_blocks,
    march,
    march_back,
    view_by_window,
)
from steerd.car_model.params import DEFAULT_CAR


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
    kernels, p, count, steps = make_kernels(), np.array(DEFAULT_CAR), 20, WORTHWHILE
    rng = np.random.default_rng(7)
    rows = np.stack([rng.uniform(-0.2, 0.2, count * steps), np.ones(count * steps)], -1)
    low = steps * np.arange(count)
    blocks = make_window_blocks(np.stack([low, low + steps, low], axis=1), np.zeros(count))
    first = np.zeros((count, 7))
    first[:, 3] = 1.0
    held, found = HeldCommands(rows, 0.005), []
    for threads in (1, 2):
        monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
        path = march(kernels, p, first, held, blocks, steps)
        seen = view_by_window(path, count)
        assert np.shares_memory(seen, path)
        back = march_back(kernels, p, path, seen, held, blocks)
        found.append((seen, back.first, back.commands, back.parameters))
        assert not len(march_back(kernels, p, path, seen, held, blocks, commands=False).commands)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
