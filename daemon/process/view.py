"""The viewer's process: the car's messages on Foxglove's WebSocket, with a scene and parameters.

Records come through a pipe that drops when full. A client must know the address, which holds a
random word, and cannot command the car; with `--view-sets` it may ask the run's terminal for other
live parameters. The viewer's end is reported and changes nothing else.
"""

# Why: docs/decisions/messages-and-sessions.md#d26

import asyncio
import base64
import sys
from collections.abc import Mapping, Sequence
from math import cos, isfinite, sin
from typing import Any

from foxglove import messages as fox  # noqa: TID251
from foxglove.messages import FrameTransforms, SceneUpdate  # noqa: TID251

from steerd.car_model.params import Car
from steerd.daemon.assembly.build import RunPlan, read_job
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.pipe_records import Gaps, PipeReader, PipeRecord
from steerd.daemon.ipc.requests import LIVE, make_sender
from steerd.daemon.learning.reported import reported_values
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.secret_server import SecretServer
from steerd.daemon.process.view_job import draw_plan, parse_view
from steerd.daemon.process.view_server import PROTOCOLS, WORDS_MAX, Channel, ViewServer
from steerd.daemon.process.views import Views
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.fields import schema_text, type_name
from steerd.steer_bus.messages import BODY, WORLD, Model, Parameters, StateMessage
from steerd.steer_bus.standard import stamp_ns
from steerd.steer_bus.topics import TOPICS, make_session_topic
from steerd.toml_text import parse_toml

_LANE = fox.Color(r=0.25, g=0.55, b=0.95, a=0.9)
_BORDER = fox.Color(r=0.6, g=0.6, b=0.6, a=0.6)
_CHASSIS = fox.Color(r=0.95, g=0.55, b=0.15, a=0.9)
_WHEEL = fox.Color(r=0.1, g=0.1, b=0.1, a=1.0)
_SPEED = fox.Color(r=0.2, g=0.75, b=0.3, a=0.9)
_WHEEL_SIZE = fox.Vector3(x=0.1, y=0.04, z=0.1)
_HEIGHT = 0.05  # of the wheels' axes over the floor [m]
_WIDTH = 0.27  # of an F1TENTH [m]


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


def make_car_scene(state: StateMessage, car: Car[float]) -> fox.SceneUpdate:
    """Chassis, steered wheels and velocity, in the body frame."""
    x = 0.5 * (car.lf - car.lr)
    size = fox.Vector3(x=1.45 * (car.lf + car.lr), y=0.7 * _WIDTH, z=0.06)
    chassis = fox.CubePrimitive(pose=_pose(x, 0.0, 0.0), size=size, color=_CHASSIS)
    wheels = [
        fox.CubePrimitive(pose=_pose(x, y, yaw), size=_WHEEL_SIZE, color=_WHEEL)
        for x, yaw in ((car.lf, state.steer), (-car.lr, 0.0))
        for y in (0.5 * _WIDTH, -0.5 * _WIDTH)
    ]
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
        cubes=[chassis, *wheels],
        arrows=[speed],
    )
    return fox.SceneUpdate(entities=[entity])


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


def make_parameters(values: Mapping[str, Any], within: str = "") -> dict[str, float | str]:
    """Nested tables of a car file as flat names: ``{"car": {"lf": 1.0}}`` as ``car.lf``."""
    flat: dict[str, float | str] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= make_parameters(value, f"{within}{name}.")
        else:
            number = isinstance(value, (bool, int, float))
            flat[within + name] = float(value) if number else str(value)
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


TRANSFORMS = "/tf"
SCENE = "/scene"
SCENE_NS = 50_000_000  # the car is drawn 20 times a second; channels carry every message
LANE_NS = 1_000_000_000  # the lane is sent again for clients that have just connected
_NICE = 10  # lower priority than the control processes'


class Viewer:
    """One car's messages, and what is drawn of them; `gaps` are messages that the pipe dropped."""

    def __init__(self, plan: RunPlan, server: ViewServer) -> None:
        self._name, self._car, self._server = plan.options.car, plan.settings.file.car, server
        drawn = draw_plan(plan)
        self._lane = make_lane_scene(drawn["lane"], drawn["half_width"], closed=drawn["closed"])
        self._views = Views()
        self._scene_due_ns = self._lane_due_ns = 0
        self.gaps = Gaps()

    def show(self, record: PipeRecord) -> None:
        """Pass one record on, with what is drawn of it."""
        name = record.topic.name
        self.gaps.take(record)
        for each in (record, *self._views.convert(record)):
            if each.topic.on_bus:
                topic = make_session_topic(self._name, each.topic)
                self._server.log(topic, each.data, each.log_time_ns)
        if name == topics.PARAMETERS.name:
            self._server.show(make_live_parameters(decode(Parameters, record.data)))
        if name == topics.MODEL.name:
            self._server.show(make_learnt_parameters(decode(Model, record.data)))
        if name == topics.STATE.name and record.log_time_ns >= self._scene_due_ns:
            self._scene_due_ns = record.log_time_ns + SCENE_NS
            self._draw(decode(StateMessage, record.data), record.log_time_ns)

    def _draw(self, state: StateMessage, log_ns: int) -> None:
        self._server.log(TRANSFORMS, make_transform(state).encode(), log_ns)
        self._server.log(SCENE, make_car_scene(state, self._car).encode(), log_ns)
        if log_ns >= self._lane_due_ns:
            self._lane_due_ns = log_ns + LANE_NS
            self._server.log(SCENE, self._lane.encode(), log_ns)


def make_channels(car: str) -> list[Channel]:
    """A car's topics as they stand in a session, CDR with their `ros2msg` text, and the scene."""
    shown = [
        (make_session_topic(car, t), "cdr", type_name(t.message), "ros2msg", schema_text(t.message))
        for t in TOPICS
        if t.on_bus
    ]
    for name, drawn in ((SCENE, SceneUpdate), (TRANSFORMS, FrameTransforms)):
        schema = drawn.get_schema()
        text = base64.b64encode(schema.data).decode()
        shown.append((name, "protobuf", schema.name, schema.encoding, text))
    names = ("topic", "encoding", "schemaName", "schemaEncoding", "schema")
    return [dict(zip(names, values, strict=True)) for values in shown]


def list_values(plan: RunPlan) -> dict[str, float | str]:
    """What a client may read of a run and its car, by flat names."""
    options, file = plan.options, plan.settings.file
    run = {"path": options.path, "speed": options.speed, "rate_hz": options.rate_hz}
    values = {"run": run, "car": file.car._asdict(), "file": parse_toml(file.text)}
    return make_parameters(values)


async def run_viewer(given: Job, plan: RunPlan) -> int:
    """Show what comes until the pipe closes; how many messages it had no room for."""
    records, reports = PipeReader(given.fds["pipe"]), PipeReader(given.fds.get("reports"))
    car = plan.options.car
    asks = make_sender(given.fds["requests"]) if "requests" in given.fds else None
    shown = ViewServer(f"steerd {car}", make_channels(car), list_values(plan), asks)
    viewer = Viewer(plan, shown)
    host, port = parse_view(plan.options.view, plan.options.insecure_lan)
    secret = SecretServer(host, shown.talk)
    server = await secret.open(port, WORDS_MAX, PROTOCOLS)
    given.say_ready(url=secret.url)
    ended = asyncio.Event()

    def read() -> None:
        for record in (*records.take(), *reports.take()):
            viewer.show(record)
        if records.fd is None:
            loop.remove_reader(pipe_fd)
            ended.set()

    loop, pipe_fd = asyncio.get_running_loop(), given.fds["pipe"]
    loop.add_reader(pipe_fd, read)
    await ended.wait()
    server.close()
    return viewer.gaps.missed


def serve(given: Job) -> int:
    """The process; it ends with the core's pipe."""
    plan = read_job(given.about)
    try:
        missed = asyncio.run(run_viewer(given, plan))
    except OSError as error:
        what = f"--view {plan.options.view}: {error}"
        raise SteerdError(what, "", ExitCode.UNREADABLE) from None
    if missed:
        print(f"note: {missed} messages did not reach the viewer", file=sys.stderr)
    return 0


if __name__ == "__main__":
    run_process(serve, _NICE)
