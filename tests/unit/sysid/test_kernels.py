"""Compiled windows against the torch reference, sensitivities against finite differences."""

from itertools import product

import numpy as np
import pytest
import torch

from benchmarks.torch_reference import simulate_reference
from steerd.car_model.model import Model
from steerd.car_model.native import windows as native
from steerd.car_model.native.specialised import SPECIALISED_SPEED
from steerd.car_model.native.windows import HeldCommands, Windows, compute_readings, make_kernels
from steerd.car_model.params import DEFAULT_CAR
from steerd.sysid.paper.paper_method import simulate

H = 0.005


def _first(rng, count, slowest=0.25):
    """States anywhere, at up to 2 m/s."""
    speed = rng.uniform(slowest, 2.0, (count, 1))
    return np.c_[rng.normal(size=(count, 3)), speed, 0.1 * rng.normal(size=(count, 3))]


def _inputs(model, count=5, steps=40):
    rng = np.random.default_rng(0)
    first = np.c_[_first(rng, count), np.zeros((count, make_kernels(model.effects).memory))]
    steer, speed = (rng.uniform(*ends, (count, steps)) for ends in ((-0.4, 0.4), (0.5, 3.0)))
    arrays = (native.parameter_vector(model), first, np.stack([steer, speed], -1))
    return [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in arrays]


@pytest.fixture(params=["base", pytest.param("rich", marks=pytest.mark.slow)])
def any_model(request, rich_model):
    car = DEFAULT_CAR._replace(steer_delay=0.013, drive_delay=0.004)
    return Model(car) if request.param == "base" else rich_model


def assert_same(fast, slow, *inputs):
    """Values, and the gradients of a sum of them with random weights."""
    assert torch.max(torch.abs(fast - slow)) < 1e-9
    weight = torch.tensor(np.random.default_rng(1).normal(size=tuple(slow.shape)))
    wanted = torch.autograd.grad((weight * slow).sum(), inputs)
    got = torch.autograd.grad((weight * fast).sum(), inputs)
    for a, b in zip(got, wanted, strict=True):
        assert torch.max(torch.abs(a - b)) < 1e-9 * torch.max(torch.abs(b))


@pytest.mark.parametrize(("integrator", "slowest"), [("euler", 0.3), ("rk4", 0.3), ("rk4", 0.8)])
def test_kernel_equals_reference_in_value_and_gradient(any_model, integrator, slowest):
    """Above walking pace a block takes the short equations, below it all of them."""
    p, first, commands = _inputs(any_model, steps=30)
    first.data[:, 3] = torch.linspace(slowest, 1.5, 5, dtype=torch.float64)
    commands.data[..., 1] = torch.clamp(commands.data[..., 1], min=slowest)
    kernels, options = make_kernels(any_model.effects), {"integrator": integrator}
    fast = simulate(kernels, p, first, commands, H, **options)
    slow = simulate_reference(p, first, commands, H, effects=any_model.effects, **options)
    assert fast.shape == slow.shape == (5, 31, 7 + kernels.memory)
    assert bool((slow[..., 3] > SPECIALISED_SPEED).all()) == (slowest > SPECIALISED_SPEED)
    assert_same(fast, slow, p, first, commands)


def test_more_windows_than_a_block_and_single_precision_is_refused():
    p, first, commands = _inputs(Model(DEFAULT_CAR), count=35, steps=12)
    with pytest.raises(TypeError, match="float64"):
        simulate(make_kernels(), p.float(), first, commands, H)
    fast = simulate(make_kernels(), p, first, commands, H)
    assert_same(fast, simulate_reference(p, first, commands, H), p, first, commands)


def _stations(kernels: native.Kernels, p, held: HeldCommands, windows: int) -> native.Stations:
    late, rows, row = native.delays_of(kernels, p)[2], [], 0
    for w, t in product(range(windows), np.arange(0.0107, 0.19, 0.0173)):
        for pose, channel in ((True, 0), (False, 3), (False, 4)):
            true = (t - pose * late) / held.fine
            rows.append((w, int(np.floor(true)), channel, row, pose, true))
            row += 3 if pose else 1
    rows.sort(key=lambda r: (r[0], r[5]))
    table = np.array([r[:5] for r in rows], np.int64)
    shares = np.array([r[5] - r[1] for r in rows])
    spans = np.searchsorted(table[:, 0], np.arange(windows + 1))
    return native.Stations(np.ascontiguousarray(table[:, 1:]), shares, spans, row)


def test_sensitivities_are_central_differences(any_model):
    kernels, p = make_kernels(any_model.effects), native.parameter_vector(any_model)
    rng = np.random.default_rng(3)
    first = _first(rng, 2, 0.4)
    commands = np.stack([rng.uniform(-0.3, 0.3, 120), rng.uniform(0.5, 3.0, 120)], -1)
    windows = Windows(np.array([[0, 120, 15, 40, 10], [0, 120, 70, 40, 10]]), np.array([0.1, 0.4]))
    held, count = HeldCommands(commands, H), len(p)
    seeds, dfirst = np.eye(count, count + 7), np.eye(7, count + 7, count)

    def readings(at):
        p, stations = at[:count], _stations(kernels, at[:count], held, 2)
        begun = first + at[count:]
        return compute_readings(kernels, p, seeds, begun, dfirst, held, windows, stations)

    at, width = np.concatenate([p, np.zeros(7)]), 1e-6
    slopes = readings(at)[1]
    for column, step in enumerate(width * np.eye(len(at))):
        central = (readings(at + step)[0] - readings(at - step)[0]) / (2 * width)
        scale = max(1.0, np.abs(central).max())
        assert np.abs(slopes[:, column] - central).max() < 2e-6 * scale, column


def _unlike(count, rows, rng):
    """Windows of all lengths, each settled for as long as it likes."""
    steps, settling = rng.integers(5, 40, count), rng.integers(0, 25, count)
    first = rng.integers(0, rows - 10, count)
    spans = np.column_stack([0 * first, 0 * first + rows, first, steps, settling])
    return Windows(spans, rng.uniform(0.0, 2.0, count))


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_window_reads_the_same_in_any_company(any_model, substeps):
    kernels, p = make_kernels(any_model.effects), native.parameter_vector(any_model)
    rng, count = np.random.default_rng(8), 19
    first = _first(rng, count, 0.3)
    commands = np.stack([rng.uniform(-0.3, 0.3, 90), rng.uniform(0.3, 3.0, 90)], -1)
    held, windows = HeldCommands(commands, H, substeps), _unlike(count, 90, rng)
    seeds = rng.normal(size=(len(p), 9)) * (rng.uniform(size=(len(p), 9)) < 0.2)
    dfirst = rng.normal(size=(7, 9))

    def read(chosen):
        part = Windows(windows.spans[chosen], windows.t[chosen])
        stations = _stations(kernels, p, held, len(chosen))
        found = compute_readings(kernels, p, seeds, first[chosen], dfirst, held, part, stations)
        return [each.reshape(len(chosen), -1) for each in found]

    together = read(np.arange(count))
    for w in range(count):
        for all_of_them, alone in zip(together, read(np.array([w])), strict=True):
            np.testing.assert_allclose(all_of_them[w], alone[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("substeps", [1, 2])
def test_settled_steering_is_that_of_the_readings(any_model, substeps):
    kernels, p = make_kernels(any_model.effects), native.parameter_vector(any_model)
    rng, count = np.random.default_rng(9), 11
    first = np.zeros((count, 7 + kernels.memory))
    first[:, 3], first[:, 6] = 1.5, rng.normal(size=count) * 0.01
    commands = np.stack([rng.uniform(-0.3, 0.3, 90), np.full(90, 1.5)], -1)
    held, windows = HeldCommands(commands, H, substeps), _unlike(count, 90, rng)
    begun = native.settle(kernels, p, first, held, windows)
    settled = Windows(windows.spans * [1, 1, 1, 1, 0], windows.t)
    seeds, dfirst = np.zeros((len(p), 1)), np.zeros((7, 1))
    stations = _stations(kernels, p, held, count)
    np.testing.assert_array_equal(begun[:, :6], first[:, :6])
    if not kernels.memory:  # what has settled memory cannot begin with it elsewhere
        ends = [
            compute_readings(kernels, p, seeds, x[:, :7], dfirst, held, part, stations)[0]
            for x, part in ((first, windows), (begun, settled))
        ]
        np.testing.assert_allclose(*ends, rtol=1e-12, atol=1e-12)
    each = [Windows(windows.spans[[w]], windows.t[[w]]) for w in range(count)]
    alone = [native.settle(kernels, p, first[[w]], held, part) for w, part in enumerate(each)]
    np.testing.assert_allclose(np.concatenate(alone), begun, rtol=1e-12, atol=1e-12)
