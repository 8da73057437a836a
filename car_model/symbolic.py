"""The equations as formulas: `Ops` over SymPy expressions.

Exact Jacobians (`car_model.generate`) and the compiled kernels of `sysid` are printed from these
formulas, so no derivative is ever written by hand. SymPy is slow to import: nothing that drives a
car imports this module.
"""

from typing import Any

import sympy

from car_model.ops import Ops
from car_model.params import Car
from car_model.single_track import Actuated, Rates, actuate, derivative
from car_model.state import Command, State

Expr = Any
"""A SymPy expression (SymPy carries no type annotations)."""


class SymbolicOps:
    """`Ops` over SymPy expressions; choices are `Piecewise`, so that they have derivatives.

    At the seam of a choice the derivative is that of the branch which `FloatOps` takes there.
    """

    sin = staticmethod(sympy.sin)
    cos = staticmethod(sympy.cos)
    tan = staticmethod(sympy.tan)
    atan = staticmethod(sympy.atan)
    tanh = staticmethod(sympy.tanh)
    exp = staticmethod(sympy.exp)
    sqrt = staticmethod(sympy.sqrt)

    @staticmethod
    def absolute(a: Expr, /) -> Expr:
        """Magnitude of `a`."""
        return sympy.Piecewise((a, a >= 0), (-a, True))

    @staticmethod
    def minimum(a: Expr, b: Expr, /) -> Expr:
        """The smaller of the two."""
        return sympy.Piecewise((a, a < b), (b, True))

    @staticmethod
    def maximum(a: Expr, b: Expr, /) -> Expr:
        """The larger of the two."""
        return sympy.Piecewise((a, a > b), (b, True))

    @staticmethod
    def clip(a: Expr, low: Expr, high: Expr, /) -> Expr:
        """`a` kept within [low, high]."""
        return sympy.Piecewise((low, a < low), (high, a > high), (a, True))

    @staticmethod
    def where_positive(condition: Expr, then: Expr, otherwise: Expr, /) -> Expr:
        """`then` where the condition is strictly positive."""
        return sympy.Piecewise((then, condition > 0), (otherwise, True))


SYMBOLIC: Ops[Expr] = SymbolicOps()


def symbols(*names: str) -> tuple[Expr, ...]:
    """A real symbol for each name."""
    return tuple(sympy.Symbol(name, real=True) for name in names)


def symbolic_car() -> Car[Expr]:
    """The car whose parameters are symbols of their own names."""
    return Car(*symbols(*Car._fields))


def symbolic_state() -> State[Expr]:
    """The state whose entries are symbols of their own names."""
    return State(*symbols(*State._fields))


def symbolic_rates() -> Rates[Expr]:
    """`derivative` as expressions in car, state, `wheel` and `accel`."""
    wheel, accel = symbols("wheel", "accel")
    return derivative(SYMBOLIC, symbolic_car(), symbolic_state(), wheel, accel)


def symbolic_actuated() -> Actuated[Expr]:
    """`actuate` as expressions in car, state, the aims `ref_steer` and `ref_speed`, and `h`."""
    ref = Command(*symbols("ref_steer", "ref_speed"))
    (h,) = symbols("h")
    return actuate(SYMBOLIC, symbolic_car(), symbolic_state(), ref, h)
