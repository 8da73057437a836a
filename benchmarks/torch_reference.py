"""The readable reference simulator: `car_model`'s own step over tensors, batched over windows.

Whatever the compiled kernels do must agree with this to 1e-9, values and gradients. It takes any
effects, any loss and any number of runs side by side, and is differentiable in everything.
"""

from collections.abc import Sequence
from typing import Any

import torch

from steerd.car_model.effect import Effect
from steerd.car_model.model import Model, Moment, delays, memory_size
from steerd.car_model.ops import Ops
from steerd.car_model.params import Car
from steerd.car_model.rollout import Integrator, arriving, euler, rk4, step
from steerd.car_model.state import Command, State

Tensor = torch.Tensor
INTEGRATORS: dict[str, Integrator[Tensor]] = {"euler": euler, "rk4": rk4}
STATES = len(State._fields)


def _same(a: Tensor, b: Tensor | float) -> Tensor:
    return b if isinstance(b, Tensor) else torch.as_tensor(b, dtype=a.dtype)


class TorchOps:
    """`Ops` over float64 tensors that broadcast against each other."""

    sin = staticmethod(torch.sin)
    cos = staticmethod(torch.cos)
    tan = staticmethod(torch.tan)
    atan = staticmethod(torch.atan)
    tanh = staticmethod(torch.tanh)
    exp = staticmethod(torch.exp)
    sqrt = staticmethod(torch.sqrt)

    @staticmethod
    def absolute(a: Tensor, /) -> Tensor:
        """Magnitude; its derivative at zero is -1, as in the compiled kernels."""
        return torch.where(a > 0.0, a, -a)

    @staticmethod
    def minimum(a: Tensor, b: Tensor | float, /) -> Tensor:
        """The smaller of the two; where they are equal, the second."""
        other = _same(a, b)
        return torch.where(a < other, a, other)

    @staticmethod
    def maximum(a: Tensor, b: Tensor | float, /) -> Tensor:
        """The larger of the two; where they are equal, the second."""
        other = _same(a, b)
        return torch.where(a > other, a, other)

    @classmethod
    def clip(cls, a: Tensor, low: Tensor | float, high: Tensor | float, /) -> Tensor:
        """`a` kept within [low, high]."""
        return cls.minimum(cls.maximum(a, low), high)

    @staticmethod
    def where_positive(
        condition: Tensor, then: Tensor | float, otherwise: Tensor | float, /
    ) -> Tensor:
        """`then` where the condition is strictly positive."""
        return torch.where(condition > 0.0, _same(condition, then), _same(condition, otherwise))


TORCH: Ops[Any] = TorchOps()


def tensor_model(effects: Sequence[Effect], parameters: Tensor) -> Model[Tensor]:
    """The model whose numbers are the entries of `parameters` (P,)."""
    every = list(parameters.unbind())
    rest = iter(every[len(Car._fields) :])
    values = tuple(tuple(next(rest) for _ in effect.parameters) for effect in effects)
    return Model(Car(*every[: len(Car._fields)]), tuple(effects), values)


def simulate_reference(
    parameters: Tensor,
    first: Tensor,
    commands: Tensor,
    h: float,
    *,
    effects: Sequence[Effect] = (),
    integrator: str = "rk4",
) -> Tensor:
    """Simulate windows side by side.

    Args:
        parameters: (P,) the car's fields, then every effect's parameters.
        first: (B, STATES) states in the order of `State`, or (B, STATES + memory).
        commands: (B, N, 2) steer [rad] and speed [m/s], each held over a step.
        h: step [s].
        effects: what is switched on.
        integrator: `rk4` or `euler`.

    Returns:
        (B, N + 1, STATES + memory) states, `first` included.
    """
    model = tensor_model(effects, parameters)
    late = delays(model)
    orders = [Command(*order.unbind(-1)) for order in commands.unbind(1)]
    moment = _first_moment(first, memory_size(tuple(effects)))
    path = [torch.stack([*moment.state, *moment.memory], dim=-1)]
    for k in range(len(orders)):
        command = arriving(orders, k, late, h)
        moment = step(TORCH, model, moment, command, k * h, h, INTEGRATORS[integrator])
        path.append(torch.stack([*moment.state, *moment.memory], dim=-1))
    return torch.stack(path, dim=1)


def _first_moment(first: Tensor, memory: int) -> Moment[Tensor]:
    numbers = list(first.unbind(-1))
    rest = numbers[STATES:] or [torch.zeros_like(numbers[0])] * memory
    return Moment(State(*numbers[:STATES]), tuple(rest))
