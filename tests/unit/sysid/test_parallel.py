"""Work on a cluster: compiled cars find their own code there, joblib's work goes there."""

import pickle

import numpy as np
import pytest
from joblib.externals.loky import process_executor

from steerd.car_model.native.windows import (
    HeldCommands,
    make_kernels,
    make_window_blocks,
    march,
    view_by_window,
)
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.parallel import map_jobs


def _square(value):
    return value * value


def _grow(value):
    process_executor._MAX_MEMORY_LEAK_SIZE = process_executor._MEMORY_LEAK_CHECK_DELAY = -1e18
    return value


@pytest.mark.slow
def test_workers_that_have_grown_make_way_without_a_word(recwarn):
    assert map_jobs(_grow, range(12), jobs=2) == [*range(12)]
    assert not recwarn.list


def test_a_compiled_car_travels_without_its_code():
    kernels = make_kernels()
    data = pickle.dumps(kernels)
    assert len(data) < 5_000
    again = pickle.loads(data)
    assert again.names == kernels.names
    held = HeldCommands(np.tile([0.1, 1.5], (50, 1)), 0.01)
    blocks = make_window_blocks(np.array([[0, 50, 0]]), np.zeros(1))
    first = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    parameters = np.array(DEFAULT_CAR)
    paths = [march(each, parameters, first, held, blocks, 50) for each in (kernels, again)]
    np.testing.assert_array_equal(view_by_window(paths[0], 1), view_by_window(paths[1], 1))
