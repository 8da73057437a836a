"""Effects of the body: masses, inertia, loads."""

from functools import partial

from steerd.car_model.effect import (
    Channel,
    Confounding,
    Effect,
    EffectParameter,
    Role,
    Stage,
    Values,
    scale,
    shift,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import Observation, State


def _cog_offset_car(ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """A shorter distance to the front axle, a longer one to the rear."""
    return car._replace(lf=car.lf - p[0], lr=car.lr + p[0])


def _cog_offset_observe(
    ops: Ops[T], p: Values[T], state: State[T], seen: Observation[T]
) -> Observation[T]:
    """The pose of where the centre of gravity was thought to be."""
    return seen._replace(x=seen.x - p[0] * ops.cos(state.yaw), y=seen.y - p[0] * ops.sin(state.yaw))


COG_OFFSET = Effect(
    name="cog_offset",
    stage=Stage.FORCES,
    family="mass",
    summary="the centre of gravity is elsewhere along the car",
    equation="lf, lr -> lf - offset, lr + offset",
    parameters=(
        EffectParameter("offset", 0.0, -0.1, 0.1, "m", 0.02, "forward of the modelled CoG"),
    ),
    least_size=0.012,
    confounded_with=Confounding(("marker_offset",), "marker_offset in slow drives"),
    in_base=False,
    at_once=False,
    car=_cog_offset_car,
    observe=_cog_offset_observe,
    aliases=("cg_offset", "cog_shift"),
)
"""A centre of gravity ahead of (or behind) where the car file has it.

The mocap body stays where it was calibrated, so the poses seen are of the old place: close to a
marker offset, and the same as one at low speed.
"""


LONGITUDINAL_LOAD_TRANSFER = Effect(
    name="longitudinal_load_transfer",
    stage=Stage.FORCES,
    family="tyre",
    summary="acceleration moves more load between the axles than modelled",
    equation="Fz = m (g l -+ (cog_height + height) accel) / L",
    parameters=(
        EffectParameter("height", 0.0, -0.1, 0.2, "m", 0.03, "CoG height beyond the car's own"),
    ),
    least_size=0.02,
    needs_commands=Channel.SPEED,
    follows_acceleration=True,
    car=partial(shift, ("cog_height",)),
    aliases=("longitudinal_transfer", "pitch_transfer", "cog_height"),
)
"""More load moved between the axles by acceleration than the CoG's height in use explains."""


def _mass_car(ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """More mass, less acceleration from the same motor, a slower loop of the same gain."""
    heavy = car.mass + p[0]
    share = car.mass / heavy
    return car._replace(
        mass=heavy,
        accel_max=car.accel_max * share,
        decel_max=car.decel_max * share,
        speed_lag=car.speed_lag * (1.0 + p[1] * p[0] / car.mass),
    )


MASS = Effect(
    name="mass",
    stage=Stage.FORCES,
    family="mass",
    summary="the car carries more (or less) than modelled",
    equation="m -> m + payload, accel limits / (1 + payload / m), "
    "speed_lag (1 + slower payload / m)",
    parameters=(
        EffectParameter("payload", 0.0, -0.15, 5.0, "kg", 0.5, "mass beyond the car's own"),
        EffectParameter("slower", 1.0, 0.0, 1.0, "1", 0.5,
                        "1: the speed loop's gain is a force per error; 0: an acceleration",
                        role=Role.FORM),
    ),
    least_size=0.16,
    confounded_with=Confounding(
        ("yaw_inertia",),
        "smaller yaw_inertia with lower acceleration limits: mass cancels from planar motion",
        alike=True,
    ),
    in_base=False,
    at_once=False,
    same_as=("inertia_z",),
    car=_mass_car,
    aliases=("payload",),
)  # fmt: skip
"""A payload at the centre of gravity.

Tyre forces grow with load as mass does, so mass cancels from the planar motion except against the
yaw inertia, which it leaves alone, and in what the motor can do: it looks like a smaller inertia,
lower acceleration limits and a slower speed loop, whose gain is a motor current per error of speed.
"""


YAW_INERTIA = Effect(
    name="yaw_inertia",
    stage=Stage.FORCES,
    family="mass",
    summary="the car is slower (or quicker) to turn than modelled",
    equation="I_z -> ratio I_z",
    parameters=(
        EffectParameter("ratio", 1.0, 0.4, 3.0, "1", 0.25, "inertia per modelled inertia"),
    ),
    least_size=0.063,
    confounded_with=Confounding(("mass",), alike=True),
    same_as=("inertia_z",),
    car=partial(scale, ("inertia_z",)),
    aliases=("inertia", "inertia_z"),
)
"""A yaw inertia other than modelled: it turns in more slowly or more quickly."""
