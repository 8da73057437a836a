"""Closed forms of the linear single-track car, to hold the product's equations against.

Source: Rajamani, Vehicle Dynamics and Control, sections 2.5 and 3.3, with stiffness per axle.
"""

from steerd.car_model.params import GRAVITY, Car, wheelbase


def axle_stiffness(car: Car[float]) -> tuple[float, float]:
    """Cornering stiffness per axle `(cf, cr)` [N/rad] at rest load: `mu C_S F_z`."""
    scale = car.mu * car.mass * GRAVITY / wheelbase(car)
    return scale * car.lr * car.c_sf, scale * car.lf * car.c_sr


def understeer_gradient(car: Car[float]) -> float:
    """Extra road-wheel angle per lateral acceleration [rad s^2/m]; negative oversteers.

    `(m / L) (lr / cf - lf / cr)` with per-axle stiffness; mass and load cancel.
    """
    return (1.0 / car.c_sf - 1.0 / car.c_sr) / (car.mu * GRAVITY)


def feedforward_steer(car: Car[float], speed: float, curvature: float) -> float:
    """Road-wheel angle [rad] that holds a path curvature [1/m]: `L k + K_us v^2 k`."""
    return (wheelbase(car) + understeer_gradient(car) * speed * speed) * curvature


def steady_slip(car: Car[float], speed: float, curvature: float) -> float:
    """Slip angle [rad] of the steady turn: `lr k - v^2 k / (mu g C_Sr)`."""
    return (car.lr - speed * speed / (car.mu * GRAVITY * car.c_sr)) * curvature
