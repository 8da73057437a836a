"""The paper's method and its baselines on its own circles."""

import numpy as np
import pytest

from steerd.sysid.paper import paper_method as paper

pytestmark = pytest.mark.slow

TRUE = np.array([paper.PAPER_CAR_DIRECT.lf, paper.PAPER_CAR_DIRECT.lr, 4.718, 5.4562])
START = np.array([0.2, 0.14, 6.5, 4.0])


@pytest.fixture(scope="module")
def problem(make_circles):
    return paper.make_problem(paper.paper_runs(make_circles(4, 2.5)))


def _sums(four):
    share = 1.0 / (paper.PAPER_CAR_DIRECT.mu * 9.81)
    lf, lr, cf, cr = four
    return np.array([lf + lr + share * (1 / cf - 1 / cr), lr - share / cr])


def test_drives_are_cut_into_the_papers_runs_and_a_standing_car_has_none(make_drive, truth):
    runs = paper.paper_runs([make_drive(truth, 20.0, 1)])
    assert [round(len(run.commands) * paper.PAPER_STEP, 1) for run in runs] == [10.0, 10.0]
    assert all(run.first[4] == run.first[5] == 0.0 for run in runs)
    run = make_drive(truth, 5.0, 1)
    run.commands[:, 1] = 0.0
    with pytest.raises(ValueError, match="speed command"):
        paper.paper_runs([run])


def test_batches_rotate(problem):
    first, second = paper.batch_of(problem, 0), paper.batch_of(problem, 1)
    assert len(first) == paper.BATCH
    assert all(a is b for a, b in zip(first[1:], second[:-1], strict=True))


def test_adam_lowers_the_loss_but_leaves_the_stiffnesses_where_they_began(problem):
    search = paper.search_adam(problem, START, 25)
    assert search.losses[-5:].min() < 0.2 * search.losses[0]
    assert np.all(np.abs(search.final[2:] - START[2:]) < 2.0)
    assert abs(_sums(search.final)[0] / _sums(TRUE)[0] - 1.0) < 0.1


def test_cma_es_finds_a_lower_loss_and_is_repeatable(problem):
    once = paper.search_cma(problem, START, trials=25, seed=3)
    again = paper.search_cma(problem, START, trials=25, seed=3)
    assert len(once.losses) == 25
    assert once.losses.min() < 0.5 * once.losses[0]
    np.testing.assert_array_equal(once.path, again.path)
