"""The car and its lane as Foxglove draws them: a transform, and shapes in its frames."""

from collections.abc import Mapping, Sequence
from math import cos, isfinite, sin
from typing import Any, NamedTuple

from foxglove import messages as fox  # noqa: TID251

from steerd.daemon.ipc.requests import LIVE
from steerd.daemon.learning.reported import reported_values
from steerd.steer_bus.messages import BODY, WORLD, Model, Parameters, StateMessage
from steerd.steer_bus.standard import stamp_ns

_LANE = fox.Color(r=0.25, g=0.55, b=0.95, a=0.9)
_BORDER = fox.Color(r=0.6, g=0.6, b=0.6, a=0.6)
_CHASSIS = fox.Color(r=0.95, g=0.55, b=0.15, a=0.9)
_WHEEL = fox.Color(r=0.1, g=0.1, b=0.1, a=1.0)
_SPEED = fox.Color(r=0.2, g=0.75, b=0.3, a=0.9)
_WHEEL_SIZE = fox.Vector3(x=0.1, y=0.04, z=0.1)
_HEIGHT = 0.05
"""Of the wheels' axes over the floor [m]."""


class Body(NamedTuple):
    """What is drawn of the car [m]: axles before and behind the CoG, and an F1TENTH's width."""

    lf: float
    lr: float
    width: float = 0.27


def make_transform(state: StateMessage) -> fox.FrameTransforms:
    """The body frame in the world."""
    frame = fox.FrameTransform(
        timestamp=_time(state),
        parent_frame_id=WORLD,
        child_frame_id=BODY,
        translation=fox.Vector3(x=state.x, y=state.y, z=0.0),
        rotation=_turn(state.yaw),
    )
    return fox.FrameTransforms(transforms=[frame])


def make_car_scene(state: StateMessage, body: Body) -> fox.SceneUpdate:
    """Chassis, steered wheels and velocity, in the body frame."""
    x = 0.5 * (body.lf - body.lr)
    size = fox.Vector3(x=1.45 * (body.lf + body.lr), y=0.7 * body.width, z=0.06)
    chassis = fox.CubePrimitive(pose=_pose(x, 0.0, 0.0), size=size, color=_CHASSIS)
    speed = fox.ArrowPrimitive(
        pose=_pose(0.0, 0.0, state.slip_angle, 2.0 * _HEIGHT),
        shaft_length=max(0.3 * state.speed, 0.0),
        shaft_diameter=0.02,
        head_length=0.06,
        head_diameter=0.05,
        color=_SPEED,
    )
    entity = fox.SceneEntity(
        timestamp=_time(state),
        frame_id=BODY,
        id="car",
        frame_locked=True,
        cubes=[chassis, *_wheels(body, state.steer)],
        arrows=[speed],
    )
    return fox.SceneUpdate(entities=[entity])


def _wheels(body: Body, steer: float) -> list[fox.CubePrimitive]:
    half = 0.5 * body.width
    places = [(body.lf, half, steer), (body.lf, -half, steer), (-body.lr, half, 0.0)]
    places.append((-body.lr, -half, 0.0))
    return [
        fox.CubePrimitive(pose=_pose(x, y, yaw), size=_WHEEL_SIZE, color=_WHEEL)
        for x, y, yaw in places
    ]


def make_lane_scene(
    points: Sequence[Sequence[float]], half_width: float, *, closed: bool
) -> fox.SceneUpdate:
    """The path on the floor, and the borders of the lane, `half_width` [m] beside it.

    `points` are samples of the path, x, y [m] and heading [rad]; a `closed` one leads to the first.
    """
    kind = fox.LinePrimitiveLineType.LineLoop if closed else fox.LinePrimitiveLineType.LineStrip

    def line(offset: float, color: fox.Color, thickness: float) -> fox.LinePrimitive:
        places = ((x - offset * sin(yaw), y + offset * cos(yaw)) for x, y, yaw in points)
        floor = [fox.Point3(x=x, y=y, z=0.0) for x, y in places]
        return fox.LinePrimitive(type=kind, points=floor, color=color, thickness=thickness)

    borders = [line(offset, _BORDER, 0.015) for offset in (half_width, -half_width)]
    lines = [line(0.0, _LANE, 0.03), *borders]
    return fox.SceneUpdate(entities=[fox.SceneEntity(frame_id=WORLD, id="lane", lines=lines)])


def make_parameters(values: Mapping[str, Any]) -> dict[str, float | str]:
    """Nested tables of a car file as flat names: ``{"car": {"lf": 1.0}}`` as ``car.lf``."""
    flat: dict[str, float | str] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            inner = make_parameters(value)
            flat |= {f"{name}.{key}": entry for key, entry in inner.items()}
        elif isinstance(value, (bool, int, float)):
            flat[name] = float(value)
        else:
            flat[name] = str(value)
    return flat


def make_live_parameters(p: Parameters) -> dict[str, float | str]:
    """Live parameters, their bounds and the answer to the last request as flat names."""
    shown: dict[str, float | str] = {
        f"live.{name}{end}": getattr(p, name + end) for name in LIVE for end in ("", "_min", "_max")
    }
    return shown | {"live.answer": p.text}


def make_learnt_parameters(model: Model) -> dict[str, float | str]:
    """The car as learnt: values, `_sd` and `_identifiable` (yes or no), and what changed."""
    shown: dict[str, float | str] = {"model.verdict": model.verdict, "model.effect": model.effect}
    for v in reported_values(model):
        numbers = {f"model.{v.name}": v.value, f"model.{v.name}_sd": v.sd}
        shown |= {name: number for name, number in numbers.items() if isfinite(number)}
        shown[f"model.{v.name}_identifiable"] = "yes" if v.identifiable else "no"
    return shown


def _pose(x: float, y: float, yaw: float, z: float = _HEIGHT) -> fox.Pose:
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=_turn(yaw))


def _turn(yaw: float) -> fox.Quaternion:
    return fox.Quaternion(x=0.0, y=0.0, z=sin(0.5 * yaw), w=cos(0.5 * yaw))


def _time(state: StateMessage) -> fox.Timestamp:
    sec, nsec = divmod(stamp_ns(state.header), 1_000_000_000)
    return fox.Timestamp(sec=sec, nsec=nsec)
