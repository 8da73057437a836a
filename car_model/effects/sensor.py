"""Effects of the measurement: mocap's body, yaw and clock."""

from functools import partial

from steerd.car_model.effect import Confounding, Effect, EffectParameter, Stage, Values, delay
from steerd.car_model.ops import Ops, T
from steerd.car_model.state import Observation, State


def _marker_offset_observe(
    ops: Ops[T], p: Values[T], state: State[T], seen: Observation[T]
) -> Observation[T]:
    """The pose of a point beside the centre of gravity."""
    c, s = ops.cos(state.yaw), ops.sin(state.yaw)
    return seen._replace(x=seen.x + (c * p[0] - s * p[1]), y=seen.y + (s * p[0] + c * p[1]))


MARKER_OFFSET = Effect(
    name="marker_offset",
    stage=Stage.OBSERVE,
    family="sensor",
    summary="the mocap body's origin is off the centre of gravity",
    equation="(x, y)_seen = (x, y) + R(yaw) (forward, left)",
    parameters=(
        EffectParameter("forward", 0.0, -2.0, 2.0, "m", 0.02, "ahead of the CoG"),
        EffectParameter("left", 0.0, -2.0, 2.0, "m", 0.02, "to the left of the CoG"),
    ),
    least_size=0.0038,
    confounded_with=Confounding(("cog_offset",), "cog_offset in slow drives"),
    on_every_car=True,
    observe=_marker_offset_observe,
    aliases=("mocap_offset", "lever_arm"),
)
"""A mocap body whose origin is not where the calibration has it on the car."""


MOCAP_LATENCY = Effect(
    name="mocap_latency",
    stage=Stage.OBSERVE,
    family="timing",
    summary="poses are older than their stamps say",
    equation="pose_seen(t) = pose(t - latency)",
    parameters=(
        EffectParameter("latency", 0.0, 0.0, 0.3, "s", 0.02, "age of a pose at its stamp"),
    ),
    least_size=0.002,
    confounded_with=Confounding(
        ("steer_delay", "drive_delay"),
        "equal dead time on both commands (steer_delay and drive_delay): the same"
        " poses without a second clock",
    ),
    same_as=("pose_delay",),
    delays=partial(delay, "pose"),
    aliases=("latency", "pose_latency", "mocap_delay"),
)
"""Poses older than their stamps say.

Exactly an equal dead time on both command channels, seen from the poses alone: never separable from
it without a second clock (a gyro, wheel speed).
"""


def _mocap_yaw_observe(
    ops: Ops[T], p: Values[T], state: State[T], seen: Observation[T]
) -> Observation[T]:
    """A heading with an offset."""
    return seen._replace(yaw=seen.yaw + p[0])


MOCAP_YAW = Effect(
    name="mocap_yaw",
    stage=Stage.OBSERVE,
    family="sensor",
    summary="the mocap body's heading is off the car's",
    equation="yaw_seen = yaw + offset",
    parameters=(
        EffectParameter("offset", 0.0, -0.3, 0.3, "rad", 0.02, "body's heading in the car"),
    ),
    least_size=0.0012,
    on_every_car=True,
    observe=_mocap_yaw_observe,
    aliases=("yaw_misalignment", "mount_yaw", "yaw_offset"),
)
"""A mocap body whose forward axis is not the car's."""
