"""The viewer's process: the car's messages on Foxglove's WebSocket, with a scene and parameters.

Records come through a pipe that drops when full. A client must know the address, which holds a
random word, and cannot command the car; with `--view-sets` it may ask the run's terminal for other
live parameters. The viewer's end is reported and changes nothing else.
"""

# Why: docs/decisions/messages-and-sessions.md#d26

import asyncio
import base64
import sys

from foxglove.messages import FrameTransforms, SceneUpdate  # noqa: TID251

from steerd.daemon.assembly.build import RunPlan, read_job
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.pipe_records import Gaps, PipeReader, PipeRecord
from steerd.daemon.ipc.requests import make_sender
from steerd.daemon.process import view_scene as scene
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.secret_server import SecretServer
from steerd.daemon.process.view_job import draw_plan, parse_view
from steerd.daemon.process.view_server import (
    PROTOCOLS,
    WORDS_MAX,
    Channel,
    ViewParameters,
    ViewServer,
)
from steerd.daemon.process.views import Views
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.fields import schema_text, type_name
from steerd.steer_bus.messages import Model, Parameters, StateMessage
from steerd.steer_bus.topics import TOPICS, make_session_topic
from steerd.toml_text import parse_toml

TRANSFORMS = "/tf"
SCENE = "/scene"
SCENE_NS = 50_000_000
"""The car is drawn 20 times a second; channels carry every message."""
LANE_NS = 1_000_000_000
"""The lane is sent again for clients that have just connected."""
_NICE = 10
"""Lower priority than the control processes'."""


class Viewer:
    """One car's messages, and what is drawn of them; `gaps` are messages that the pipe dropped."""

    def __init__(self, car: str, body: scene.Body, lane: SceneUpdate, server: ViewServer) -> None:
        self._car, self._server = car, server
        self._body, self._lane = body, lane
        self._views = Views()
        self._scene_due_ns = self._lane_due_ns = 0
        self.gaps = Gaps()

    def show(self, record: PipeRecord) -> None:
        """Pass one record on, with what is drawn of it."""
        name = record.topic.name
        self.gaps.take(record)
        for each in (record, *self._views.convert(record)):
            if each.topic.on_bus:
                topic = make_session_topic(self._car, each.topic)
                self._server.log(topic, each.data, each.log_time_ns)
        if name == topics.PARAMETERS.name:
            self._server.show(scene.make_live_parameters(decode(Parameters, record.data)))
        if name == topics.MODEL.name:
            self._server.show(scene.make_learnt_parameters(decode(Model, record.data)))
        if name == topics.STATE.name and record.log_time_ns >= self._scene_due_ns:
            self._scene_due_ns = record.log_time_ns + SCENE_NS
            self._draw(decode(StateMessage, record.data), record.log_time_ns)

    def _draw(self, state: StateMessage, log_ns: int) -> None:
        self._server.log(TRANSFORMS, scene.make_transform(state).encode(), log_ns)
        self._server.log(SCENE, scene.make_car_scene(state, self._body).encode(), log_ns)
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
    return scene.make_parameters(values)


async def run_viewer(given: Job, plan: RunPlan) -> int:
    """Show what comes until the pipe closes; how many messages it had no room for.

    Raises:
        OSError: the address is taken or no address of this machine.
    """
    records, car, drawn = PipeReader(given.fds["pipe"]), plan.options.car, draw_plan(plan)
    lane = scene.make_lane_scene(drawn["lane"], drawn["half_width"], closed=drawn["closed"])
    asks = make_sender(given.fds["requests"]) if "requests" in given.fds else None
    shown = ViewServer(f"steerd {car}", make_channels(car), ViewParameters(list_values(plan), asks))
    viewer = Viewer(car, scene.Body(**drawn["body"]), lane, shown)
    host, port = parse_view(plan.options.view, plan.options.insecure_lan)
    secret = SecretServer(host, shown.talk)
    server = await secret.open(port, WORDS_MAX, PROTOCOLS)
    given.say_ready(url=secret.url)
    ended = asyncio.Event()

    def read() -> None:
        for record in records.take():
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
    """The process; it ends with the core's pipe.

    Raises:
        SteerdError: its address cannot be used.
    """
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
