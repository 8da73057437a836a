"""Gross regressions of speed, as ratios in one process: generous bounds, CPU time."""

import time
from collections.abc import Callable

import numpy as np
import pytest
import torch

from steerd.car_model.native.windows import make_kernels
from steerd.car_model.params import Car
from steerd.daemon.assembly.build import make_plan
from steerd.daemon.offline.virtual import make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.sysid.paper.torch_kernel import simulate
from steerd.sysid.paper.torch_sim import PAPER_CAR_DIRECT, simulate_reference

pytestmark = pytest.mark.slow

CALLS = 50_000
TICK_CALLS_MOST = 150_000
"""A tick in virtual time costs as much as this many calls of an empty function (38,000 now)."""
KERNEL_GAIN_LEAST = 40.0
"""The compiled kernel is this many times faster than the torch reference (300 now)."""


def cpu(call: Callable[[], object]) -> float:
    """Least CPU time of three calls [s]."""
    found = []
    for _ in range(3):
        began = time.process_time()
        call()
        found.append(time.process_time() - began)
    return min(found)


def test_a_tick_costs_no_more_calls_than_it_should() -> None:
    plan = make_plan(RunOptions(car_file="", simulated=True, auto_arm=True, speed=1.5))
    run = make_virtual_run(plan)
    while run.t_ns < 2_000_000_000:
        run.step()

    def ticks() -> None:
        for _ in range(100):
            run.step()

    def nothing(x: int) -> int:
        return x

    def calls() -> None:
        for k in range(CALLS):
            nothing(k)

    tick, call = cpu(ticks) / 100, cpu(calls) / CALLS
    assert run.core.loop.perception.accepted_ns is not None
    assert tick / call < TICK_CALLS_MOST


def test_the_kernel_stays_far_ahead_of_the_reference() -> None:
    first = torch.zeros((16, 7), dtype=torch.float64)
    first[:, 3] = 1.0
    commands = torch.tensor([0.1, 1.0], dtype=torch.float64).expand(16, 50, 2).contiguous()
    kernels = make_kernels()

    def slopes(run: Callable[[torch.Tensor], torch.Tensor]) -> np.ndarray:
        car: Car[float] = PAPER_CAR_DIRECT
        parameters = torch.tensor(list(car), dtype=torch.float64, requires_grad=True)
        run(parameters)[..., :2].square().sum().backward()
        assert parameters.grad is not None
        return parameters.grad.numpy()

    def compiled() -> np.ndarray:
        return slopes(lambda p: simulate(kernels, p, first, commands, 0.01))

    def reference() -> np.ndarray:
        return slopes(lambda p: simulate_reference(p, first, commands, 0.01))

    np.testing.assert_allclose(compiled(), reference(), rtol=1e-6, atol=1e-6)

    def often() -> None:
        for _ in range(20):
            compiled()

    assert cpu(reference) / (cpu(often) / 20) > KERNEL_GAIN_LEAST
