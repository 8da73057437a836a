"""Effects of the steering: command, servo, linkage."""

from functools import partial

from steerd.car_model.effect import (
    Channel,
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
from steerd.car_model.state import Command


def _steer_asymmetry_linkage(
    ops: Ops[T], p: Values[T], memory: Values[T], angle: T
) -> tuple[T, tuple[T, ...]]:
    """More gain to the left, as much less to the right."""
    return angle + p[0] * ops.absolute(angle), ()


STEER_ASYMMETRY = Effect(
    name="steer_asymmetry",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="left and right turns get different wheel angles",
    equation="wheel = steer + asymmetry |steer|",
    parameters=(
        EffectParameter("asymmetry", 0.0, -0.5, 0.5, "1", 0.1,
                        "gain 1 + this to the left, 1 - this to the right"),
    ),
    least_size=0.0045,
    needs_commands=Channel.STEER,
    on_every_car=True,
    linkage=_steer_asymmetry_linkage,
    aliases=("left_right_asymmetry", "steering_asymmetry"),
)  # fmt: skip
"""A linkage that turns further to one side than to the other."""


def _steer_backlash_linkage(
    ops: Ops[T], p: Values[T], memory: Values[T], angle: T
) -> tuple[T, tuple[T, ...]]:
    """The last wheel angle, kept within the gap about the servo's."""
    half = 0.5 * p[0]
    wheel = ops.clip(memory[0], angle - half, angle + half)
    return wheel, (wheel,)


STEER_BACKLASH = Effect(
    name="steer_backlash",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="play in the steering linkage",
    equation="wheel = clip(last wheel, steer - play/2, steer + play/2)",
    parameters=(
        EffectParameter("play", 0.0, 0.0, 0.15, "rad", 0.02, "whole width of the gap",
                        scan=(0.005, 0.01, 0.02, 0.03, 0.04, 0.06)),
    ),
    least_size=0.0019,
    needs_commands=Channel.STEER,
    memory=1,
    linkage=_steer_backlash_linkage,
    aliases=("backlash", "play", "steer_deadband"),
)  # fmt: skip
"""Play in the linkage: the wheels follow only after the slack is taken up.

The play operator: the wheel angle stays until the servo pushes it from one side of the gap or the
other. It has a kink at the null (the gap cannot be negative): look for it with a scan.
"""


STEER_BIAS = Effect(
    name="steer_bias",
    stage=Stage.COMMAND,
    family="steering",
    summary="the wheels are off centre at command zero (trim)",
    equation="aim = clip(steer_gain cmd + steer_bias + bias)",
    parameters=(
        EffectParameter("bias", 0.0, -0.15, 0.15, "rad", 0.02, "trim beyond the car's own"),
    ),
    least_size=0.0006,
    needs_commands=Channel.STEER,
    same_as=("steer_bias",),
    car=partial(shift, ("steer_bias",)),
    aliases=("trim", "steer_trim", "steer_offset"),
)
"""Steering trim: the wheels do not point straight at command zero."""


def _steer_clip_reference(ops: Ops[T], p: Values[T], ref: Command[T], t: float) -> Command[T]:
    """The servo aims no further than the stop."""
    return ref._replace(steer=ops.clip(ref.steer, -p[0], p[0]))


STEER_CLIP = Effect(
    name="steer_clip",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the wheels stop before the model's end stops",
    equation="aim = clip(aim, -limit, limit)",
    parameters=(
        EffectParameter("limit", 1.0, 0.03, 1.0, "rad", 0.75, "largest wheel angle either way",
                        scan=(0.1, 0.15, 0.2, 0.24, 0.28, 0.3, 0.32, 0.34, 0.36, 0.38, 0.4)),
    ),
    least_size=0.0,
    needs_commands=Channel.STEER,
    reference=_steer_clip_reference,
    aliases=("clip", "end_stop", "steer_limit"),
)  # fmt: skip
"""End stops inside the model's: a servo limit, a wheel touching the chassis.

Where no command passes the stop it changes nothing, so its gradient at the null is zero: it must be
looked for with a scan.
"""


STEER_DELAY = Effect(
    name="steer_delay",
    stage=Stage.COMMAND,
    family="timing",
    summary="the steering command takes effect late",
    equation="steer_cmd(t) -> steer_cmd(t - delay)",
    parameters=(
        EffectParameter("delay", 0.0, 0.0, 0.3, "s", 0.03, "dead time beyond the car's own"),
    ),
    least_size=0.0015,
    needs_commands=Channel.STEER,
    same_as=("steer_delay",),
    delays=partial(delay, "steer"),
    aliases=("steering_delay", "steer_latency"),
)
"""Dead time between the steering command and the servo."""


STEER_GAIN = Effect(
    name="steer_gain",
    stage=Stage.COMMAND,
    family="steering",
    summary="the linkage turns the wheels more or less than modelled",
    equation="aim = clip(gain steer_gain cmd + steer_bias)",
    parameters=(
        EffectParameter("gain", 1.0, 0.5, 1.6, "1", 0.1, "ratio to the car's steering gain"),
    ),
    least_size=0.009,
    needs_commands=Channel.STEER,
    same_as=("steer_gain",),
    car=partial(scale, ("steer_gain",)),
    aliases=("steering_gain", "steer_scale"),
)
"""More or less wheel angle per command than the model's linkage."""


STEER_LAG = Effect(
    name="steer_lag",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the servo answers more slowly than the model's",
    equation="(steer_lag + lag) d(steer)/dt = aim - steer",
    parameters=(
        EffectParameter("lag", 0.0, -0.1, 0.4, "s", 0.05, "time constant beyond the car's own"),
    ),
    least_size=0.003,
    needs_commands=Channel.STEER,
    same_as=("steer_lag",),
    car=partial(shift, ("steer_lag",)),
    aliases=("servo_lag", "steering_lag"),
)
"""A slower steering servo."""


def _steer_nonlinearity_linkage(
    ops: Ops[T], p: Values[T], memory: Values[T], angle: T
) -> tuple[T, tuple[T, ...]]:
    """A cubic on top of the straight line."""
    return angle + p[0] * angle * angle * angle, ()


STEER_NONLINEARITY = Effect(
    name="steer_nonlinearity",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the linkage's gain changes towards the ends",
    equation="wheel = steer + cubic steer^3",
    parameters=(
        EffectParameter("cubic", 0.0, -2.85, 4.0, "1/rad^2", 1.0,
                        "at -1 the wheels turn 12 % less at 0.34 rad"),
    ),
    least_size=0.2,
    needs_commands=Channel.STEER,
    on_every_car=True,
    linkage=_steer_nonlinearity_linkage,
    aliases=("steer_cubic", "steering_nonlinearity"),
)  # fmt: skip
"""A linkage that bends: less (or more) wheel angle towards the ends.

The lower bound is 1 / (3 x 0.34^2): beyond it the wheels would turn back at the ends.
"""


STEER_RATE_LIMIT = Effect(
    name="steer_rate_limit",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the servo turns no faster than its slew rate",
    equation="|d(steer)/dt| <= rate",
    parameters=(
        EffectParameter("rate", 50.0, 0.2, 50.0, "rad/s", 45.0, "largest speed of the wheel angle",
                        scan=(0.5, 0.8, 1.2, 1.6, 2.0, 2.5, 3.0, 4.0)),
    ),
    least_size=0.0,
    needs_commands=Channel.STEER,
    same_as=("steer_rate",),
    car=partial(cap, ("steer_rate",)),
    aliases=("rate_limit", "slew_limit", "steer_slew"),
)  # fmt: skip
"""A servo that turns no faster than so.

Below the limit it changes nothing, so its gradient at the null is zero: it must be looked for with
a scan.
"""
