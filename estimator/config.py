"""What the filter believes about its instruments and about what its model leaves out."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any


def _between(low: float, high: float, default: Any) -> Any:
    """A setting and its bounds, between which a simulated car drives.

    Below, the filter believes itself and refuses true poses (W5); above, it believes nothing and is
    never sure (W6): tests/safety/test_car_file_bounds.py.
    """
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True)
class FilterConfig:
    """Standard deviations of the instruments, and densities of the unmodelled motion.

    A density is the square root of a two-sided spectral density: unmodelled acceleration of
    standard deviation `s` that keeps its sign for about `tau` seconds has `s * sqrt(2 * tau)`.
    """

    pose_position_sd: float = _between(1e-4, 1.0, 0.001)
    """Noise of mocap x and of y [m]; a calibrated room has 0.5 mm, the rest is the marker plate."""
    pose_yaw_sd: float = _between(1e-6, 1.0, 0.002)
    """Noise of mocap yaw [rad]: half a millimetre over a plate of a quarter metre."""
    wheel_speed_sd: float = _between(1e-6, 10.0, 0.03)
    """Noise and small slip of the reported wheel speed [m/s]."""
    gyro_sd: float = _between(1e-6, 10.0, 0.03)  # noise and bias of the gyro's yaw rate [rad/s]
    longitudinal_accel_density: float = _between(0.1, 100.0, 0.3)
    """Unmodelled longitudinal acceleration [m/s^2/sqrt(Hz)]: 0.7 m/s^2 for 0.1 s at a time."""
    lateral_accel_density: float = _between(0.03, 10.0, 0.3)
    """Unmodelled lateral acceleration [m/s^2/sqrt(Hz)]; divided by speed it drives the slip."""
    yaw_accel_density: float = _between(0.0, 30.0, 1.0)
    """Unmodelled yaw acceleration [rad/s^2/sqrt(Hz)]: 2.2 rad/s^2 for 0.1 s at a time."""
    steer_rate_density: float = _between(0.0, 10.0, 0.05)
    """Unmodelled motion of the steering [rad/s/sqrt(Hz)]: the servo is not measured."""
    position_density: float = _between(0.0, 1.0, 0.0005)
    """Sideways creep that no velocity explains: suspension, marker plate [m/sqrt(s)]."""
    yaw_density: float = _between(0.0, 1.0, 0.0005)  # the same for yaw [rad/sqrt(s)]
    gate_probability: float = _between(0.9, 1.0 - 1e-9, 0.999)
    """A true measurement passes its gate this often (chi-square of 3 degrees: 16.3)."""
    history_s: float = _between(0.5, 2.0, 0.6)
    """How old a measurement may be at arrival and still be fused where it belongs [s]."""
    initial_poses: int = _between(5, 50, 10)  # mutually consistent poses that start the filter

    @property
    def noise_density(self) -> tuple[float, ...]:
        """Spectral densities of the states' unmodelled rates (7,), squared units per second.

        Of the slip angle the root of the lateral acceleration's, which a step divides by the speed.
        """
        return (
            self.position_density**2,
            self.position_density**2,
            self.yaw_density**2,
            self.longitudinal_accel_density**2,
            self.yaw_accel_density**2,
            self.lateral_accel_density,
            self.steer_rate_density**2,
        )


def load_filter_config(mapping: Mapping[str, object]) -> FilterConfig:
    """Make the configuration from a car file's `[filter]` table; absent keys keep defaults.

    Raises:
        ValueError: naming each key that is unknown, not a number or out of its limits.
    """
    problems = [problem for key, value in mapping.items() if (problem := _problem(key, value))]
    if problems:
        raise ValueError("filter configuration: " + "; ".join(problems))
    usual: dict[str, Any] = asdict(FilterConfig())
    return FilterConfig(**{key: type(usual[key])(value) for key, value in mapping.items()})


def _problem(key: str, value: object) -> str:
    known = {f.name: f for f in fields(FilterConfig)}
    if key not in known:
        return f"unknown key {key!r} (known: {', '.join(known)})"
    low, high = known[key].metadata["low"], known[key].metadata["high"]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{key} must be a number, not {value!r}"
    if isinstance(known[key].default, int) and not isinstance(value, int):
        return f"{key} must be a whole number, not {value!r}"
    if not (math.isfinite(value) and low <= value <= high):
        return f"{key} = {value!r} is outside {low:g} .. {high:g}"
    return ""
