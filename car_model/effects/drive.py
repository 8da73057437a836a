"""Effects of the drive: speed command, motor, battery, drag."""

from functools import partial

from steerd.car_model.chassis import SPEED_DYNAMIC, Rates, dynamic_share
from steerd.car_model.effect import (
    Channel,
    Confounding,
    Contact,
    Effect,
    EffectParameter,
    Stage,
    Values,
    cap,
    delay,
    scale,
    shift,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.state import Command, Observation, State

ACCEL_LIMIT = Effect(
    name="accel_limit",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="current or ramp limits cap the acceleration",
    equation="|d(speed)/dt| <= limit",
    parameters=(
        EffectParameter("limit", 20.0, 0.2, 20.0, "m/s^2", 16.0,
                        "largest acceleration and deceleration",
                        scan=(0.5, 1.0, 1.5, 2.0, 3.0, 4.0)),
    ),
    least_size=0.0,
    needs_commands=Channel.SPEED,
    same_as=("accel_max", "decel_max"),
    car=partial(cap, ("accel_max", "decel_max")),
    aliases=("current_limit", "acceleration_limit"),
)  # fmt: skip
"""A motor that cannot speed up or brake as hard as the model's.

Below the limit it changes nothing, so its gradient at the null is zero: it must be looked for with
a scan.
"""


def _battery_sag_reference(ops: Ops[T], p: Values[T], ref: Command[T], t: float) -> Command[T]:
    """A speed aim that fades over the run."""
    return ref._replace(speed=ref.speed * ops.exp(-p[0] * (t / 60.0)))


BATTERY_SAG = Effect(
    name="battery_sag",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="speed per command falls over the run",
    equation="speed aim = speed_gain cmd exp(-rate t)",
    parameters=(
        EffectParameter("rate", 0.0, -0.3, 1.0, "1/min", 0.05, "share of speed lost per minute"),
    ),
    least_size=0.025,
    needs_commands=Channel.SPEED,
    in_base=False,
    at_once=False,
    reference=_battery_sag_reference,
    aliases=("battery", "voltage_sag"),
)
"""A battery that runs down: the same command gives less and less speed.

The motor controller sees the lower speed too, so its report stays true.
"""


DRIVE_DELAY = Effect(
    name="drive_delay",
    stage=Stage.COMMAND,
    family="timing",
    summary="the speed command takes effect late",
    equation="speed_cmd(t) -> speed_cmd(t - delay)",
    parameters=(
        EffectParameter("delay", 0.0, 0.0, 0.3, "s", 0.03, "dead time beyond the car's own"),
    ),
    least_size=0.004,
    needs_commands=Channel.SPEED,
    same_as=("drive_delay",),
    delays=partial(delay, "drive"),
    aliases=("speed_delay", "motor_delay"),
)
"""Dead time between the speed command and the motor."""


DRIVE_LAG = Effect(
    name="drive_lag",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="speed follows its command more slowly than the model's",
    equation="(speed_lag + lag) d(speed)/dt = aim - speed",
    parameters=(
        EffectParameter("lag", 0.0, -0.2, 0.6, "s", 0.08, "time constant beyond the car's own"),
    ),
    least_size=0.0055,
    needs_commands=Channel.SPEED,
    same_as=("speed_lag",),
    car=partial(shift, ("speed_lag",)),
    aliases=("motor_lag", "speed_lag", "esc_lag"),
)
"""A slower speed loop."""


def _drive_split_rates(ops: Ops[T], p: Values[T], at: Contact[T], rates: Rates[T]) -> Rates[T]:
    """Less speed over ground and more moment where the front axle drives more."""
    share = dynamic_share(ops, at.state.speed)
    speed = ops.maximum(at.state.speed, SPEED_DYNAMIC)
    sine, sideslip = ops.sin(at.wheel), ops.tan(at.state.slip_angle)
    felt = rates.speed - at.state.yaw_rate * at.state.speed * sideslip
    side = share * p[0] * (at.car.mass * felt + at.forces.front * sine) * sine
    rolled = ops.cos(at.wheel) + (sideslip + at.car.lf * at.state.yaw_rate / speed) * sine
    further = 1.0 + p[0] * (rolled - 1.0)
    turn = rates.slip_angle + share * at.state.yaw_rate
    sideways = side / (at.car.mass * speed)
    return rates._replace(
        x=rates.x / further,
        y=rates.y / further,
        yaw_rate=rates.yaw_rate + side * at.car.lf / at.car.inertia_z,
        slip_angle=rates.slip_angle + share * turn * (further - 1.0) + sideways,
    )


DRIVE_SPLIT = Effect(
    name="drive_split",
    stage=Stage.FORCES,
    family="drive",
    summary="the front axle drives more (or less) than its share",
    equation="F_x,front += front F_x; ground speed /= 1 + front (v_wheel,front / v_x - 1)",
    parameters=(
        EffectParameter("front", 0.0, -1.0, 1.0, "1", 0.25, "share of the drive force, added"),
    ),
    least_size=0.1,
    on_every_car=True,
    follows_acceleration=True,
    rates=_drive_split_rates,
    aliases=("torque_split", "centre_differential"),
)
"""How the motor's force divides between the axles: differentials and driveline, not the car file.

The chassis says which wheels are driven; an open centre differential, a worn slipper clutch or
tyres of two kinds move the front axle's share. Steered wheels that drive pull the car into the
bend, and they roll along their own direction, `v_x cos(delta) + (v_y + l_f r) sin(delta)`: what
they turn the motor by is not what the rear wheels do.
"""


_FADE = 10.0  # full drag from about 0.2 m/s up [s/m]


def _rolling_drag_rates(ops: Ops[T], p: Values[T], at: Contact[T], rates: Rates[T]) -> Rates[T]:
    """Less acceleration, against the direction of travel."""
    return rates._replace(speed=rates.speed - p[0] * ops.tanh(_FADE * at.state.speed))


ROLLING_DRAG = Effect(
    name="rolling_drag",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="rolling resistance slows the car",
    equation="d(speed)/dt = accel - drag tanh(speed / 0.1)",
    parameters=(
        EffectParameter("drag", 0.0, -1.0, 3.0, "m/s^2", 0.4, "deceleration when left to roll"),
    ),
    least_size=0.07,
    confounded_with=Confounding(("speed_scale",), "speed_scale at a single speed"),
    needs_commands=Channel.SPEED,
    on_every_car=True,
    rates=_rolling_drag_rates,
    aliases=("drag", "rolling_resistance", "friction_drag"),
)
"""Rolling resistance of tyres and drivetrain.

The same at all speeds but fading out at standstill; against a speed loop with a lag it leaves a
constant speed error, so at one speed it looks like a speed scale.
"""
# Why: docs/decisions/diagnosis.md#d53


def _speed_scale_observe(
    ops: Ops[T], p: Values[T], state: State[T], seen: Observation[T]
) -> Observation[T]:
    """Wheel speed in the motor controller's own measure."""
    return seen._replace(wheel_speed=seen.wheel_speed / p[0])


SPEED_SCALE = Effect(
    name="speed_scale",
    stage=Stage.COMMAND,
    family="drive",
    summary="wheel radius or gear differ from the speed gain in use",
    equation="speed aim = scale speed_gain cmd; wheel_speed = speed / (scale speed_gain)",
    parameters=(
        EffectParameter("scale", 1.0, 0.6, 1.5, "1", 0.05, "true speed per modelled true speed"),
    ),
    least_size=0.0032,
    confounded_with=Confounding(("rolling_drag",), "rolling_drag at a single speed"),
    needs_commands=Channel.SPEED,
    same_as=("speed_gain",),
    car=partial(scale, ("speed_gain",)),
    observe=_speed_scale_observe,
    aliases=("erpm_gain", "wheel_radius", "speed_gain"),
)
"""A wheel that is larger or smaller than the motor controller's gain says.

True speed changes against the command and against the reported wheel speed alike, so the reported
speed stays true to the command.
"""
