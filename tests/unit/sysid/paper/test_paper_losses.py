"""The paper's two losses against brute force and hand-made values."""

import itertools

import numpy as np
import pytest
import torch

from steerd.sysid.paper.paper_method import chamfer, soft_dtw, squared_distances


def _alignments(rows, columns):
    """Every monotone path of index pairs from (0, 0) to the far corner."""
    if rows == columns == 1:
        return [[(0, 0)]]
    before = ((rows - down, columns - right) for down, right in ((1, 0), (0, 1), (1, 1)))
    paths = (path for at in before if all(at) for path in _alignments(*at))
    return [[*path, (rows - 1, columns - 1)] for path in paths]


def _brute_force(cost, gamma):
    rows, columns = cost.shape
    totals = np.array([sum(cost[i, j] for i, j in p) for p in _alignments(rows, columns)])
    return -gamma * np.log(np.exp(-(totals - totals.min()) / gamma).sum()) + totals.min()


@pytest.mark.parametrize("gamma", [0.01, 0.1, 1.0])
@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 4), (3, 2), (4, 5), (5, 5)])
def test_soft_dtw_is_the_soft_minimum_over_all_alignments(rows, columns, gamma):
    rng = np.random.default_rng(rows * 10 + columns)
    cost = rng.uniform(0.0, 2.0, (3, rows, columns))
    got = soft_dtw(torch.from_numpy(cost), gamma).numpy()
    want = [_brute_force(each, gamma) for each in cost]
    np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-12)


def test_soft_dtw_of_long_paths_stays_finite_and_may_be_negative():
    line = torch.linspace(0.0, 10.0, 400, dtype=torch.float64)[None, :, None]
    value = soft_dtw(squared_distances(line, line), 0.1)
    assert torch.isfinite(value).all()
    assert value.item() < 0.0


def test_chamfer_against_all_pairs_and_its_gradient():
    rng = np.random.default_rng(3)
    a, b = (torch.from_numpy(rng.normal(size=(n, 2))) for n in (30, 41))
    table = squared_distances(a[None], b[None])[0]
    want = table.min(1).values.mean() + table.min(0).values.mean()
    assert chamfer(a, b).item() == pytest.approx(want.item(), rel=1e-12)
    assert torch.autograd.gradcheck(lambda x: chamfer(x, b), a.requires_grad_())


@pytest.mark.parametrize(("bad", "side"), list(itertools.product([np.nan, np.inf], [0, 1])))
def test_chamfer_of_what_is_not_finite_is_nan(bad, side):
    sets = [torch.zeros(3, 2, dtype=torch.float64), torch.zeros(4, 2, dtype=torch.float64)]
    sets[side][1, 0] = bad
    assert torch.isnan(chamfer(*sets))
