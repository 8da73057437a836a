"""CommonRoad's multi-body model, compiled as it stands.

`vehicle_dynamics_mb` of the package `commonroad-vehicle-models` (BSD) is not written anew here: the
package's own code objects are compiled, with parameters as tuples instead of objects.
"""

from collections import namedtuple
from collections.abc import Callable
from dataclasses import fields
from types import FunctionType, ModuleType
from typing import Any

import vehiclemodels.utils.tire_model as tire_model
from numba import njit
from vehiclemodels.utils.acceleration_constraints import acceleration_constraints
from vehiclemodels.utils.longitudinal_parameters import LongitudinalParameters
from vehiclemodels.utils.steering_constraints import steering_constraints
from vehiclemodels.utils.steering_parameters import SteeringParameters
from vehiclemodels.utils.tireParameters import TireParameters
from vehiclemodels.utils.vehicle_dynamics_ks_cog import vehicle_dynamics_ks_cog
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import VehicleParameters

STATES = 29
_GROUPS = {
    "steering": SteeringParameters,
    "longitudinal": LongitudinalParameters,
    "tire": TireParameters,
}
_NOT_USED = ("trailer",)

Steering = namedtuple("Steering", [f.name for f in fields(SteeringParameters)])
Longitudinal = namedtuple("Longitudinal", [f.name for f in fields(LongitudinalParameters)])
Tire = namedtuple("Tire", [f.name for f in fields(TireParameters)])
Vehicle = namedtuple(
    "Vehicle", [f.name for f in fields(VehicleParameters) if f.name not in _NOT_USED]
)
_TUPLES = {"steering": Steering, "longitudinal": Longitudinal, "tire": Tire}


def as_tuple(parameters: Any) -> Any:
    """The package's parameter object as tuples of floats, which compiled code takes; 0 for None."""

    def flat(group: Any, kind: Any) -> Any:
        return kind(*(float(getattr(group, name) or 0.0) for name in kind._fields))

    values = []
    for name in Vehicle._fields:
        value = getattr(parameters, name)
        kind = _TUPLES.get(name)
        values.append(float(value or 0.0) if kind is None else flat(value, kind))
    return Vehicle(*values)


def _compiled(function: Callable[..., Any], **names: Any) -> Any:
    """The function's own code, compiled, with some of the names that it calls replaced."""
    return njit(FunctionType(function.__code__, {**function.__globals__, **names}))


def _compiled_tyres() -> ModuleType:
    """The package's tyre formulas, compiled, in a module of the same shape."""
    module = ModuleType("compiled_tyres")
    sign = _compiled(tire_model.sign)
    for name in ("longitudinal", "lateral", "longitudinal_comb", "lateral_comb"):
        name = f"formula_{name}"
        setattr(module, name, _compiled(getattr(tire_model, name), sign=sign))
    return module


_limits = {
    "steering_constraints": _compiled(steering_constraints),
    "acceleration_constraints": _compiled(acceleration_constraints),
}
rhs = _compiled(
    vehicle_dynamics_mb,
    tireModel=_compiled_tyres(),
    vehicle_dynamics_ks_cog=_compiled(vehicle_dynamics_ks_cog, **_limits),
    **_limits,
)
"""The package's derivative: state (29,), inputs (steering velocity, acceleration), `Vehicle`."""
