"""The chi-square gate against SciPy's quantile."""

import pytest
from scipy.special import chdtri

from steerd.estimator.sensors import chi_square_gate


@pytest.mark.parametrize("degrees", [1, 2, 3, 7])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.999, 0.999999])
def test_gate_is_scipys_quantile(degrees, probability):
    expected = chdtri(degrees, 1.0 - probability)
    assert chi_square_gate(degrees, probability) == pytest.approx(expected, rel=1e-9)
