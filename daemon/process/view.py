"""The viewer's process: the car's messages on Foxglove's WebSocket, with a scene and parameters.

Records come through a pipe that drops when full. A client cannot command the car; with
`--view-sets` it may ask the run's terminal for other live parameters. The viewer's end is reported
and changes nothing else.
"""

# Why: docs/decisions/messages-and-sessions.md#d26

import contextlib
import json
import os
import socket
import sys
from collections.abc import Callable, Mapping
from typing import Any

import foxglove  # noqa: TID251
from foxglove.channels import FrameTransformsChannel, SceneUpdateChannel  # noqa: TID251
from foxglove.websocket import Capability, Client, Parameter, ServerListener  # noqa: TID251

from steerd.daemon.ipc.live_setting import LIVE, format_setting
from steerd.daemon.ipc.pipe_records import PipeRecord, unpack_records
from steerd.daemon.ipc.signals import ignore_terminal_signals
from steerd.daemon.process.view_scene import (
    Body,
    LaneLines,
    make_car_scene,
    make_lane,
    make_lane_scene,
    make_learnt_parameters,
    make_live_parameters,
    make_parameters,
    make_transform,
)
from steerd.daemon.process.views import Views
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, schema_text, type_name
from steerd.steer_bus.messages import Model, Parameters, StateMessage
from steerd.steer_bus.topics import TOPICS, Topic, make_session_topic

TRANSFORMS = "/tf"
SCENE = "/scene"
SCENE_NS = 50_000_000
"""The car is drawn 20 times a second; channels carry every message."""
LANE_NS = 1_000_000_000
"""The lane is sent again for clients that have just connected."""
_READ_BYTES = 1 << 20
_NICE = 10
"""Lower priority than the control processes'."""


class ReadOnlyParameters(ServerListener):
    """Parameters that can be read; setting one returns the old value.

    Where the run allows it (`--view-sets`), setting a live parameter asks the run's terminal for
    it. Its new value comes back from the car, if it is accepted.
    """

    def __init__(
        self, values: Mapping[str, float | str], ask: Callable[[str], object] | None = None
    ) -> None:
        self._values = dict(values)
        self._ask = ask

    def take(self, live: Mapping[str, float | str]) -> list[Parameter]:
        """Take in live parameters; those that are new or have changed."""
        changed = {n: v for n, v in live.items() if self._values.get(n) != v}
        self._values |= changed
        return [Parameter(n, value=v) for n, v in changed.items()]

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        """Those named, or all."""
        wanted = param_names or list(self._values)
        return [Parameter(n, value=self._values[n]) for n in wanted if n in self._values]

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Ask for live parameters; a car file does not change during a drive."""
        for parameter in parameters:
            group, _, name = parameter.name.partition(".")
            if self._ask is None or group != "live" or name not in LIVE:
                continue
            value = parameter.get_value()
            if isinstance(value, int | float) and not isinstance(value, bool):
                self._ask(format_setting(name, float(value)))
        return self.on_get_parameters(client, [p.name for p in parameters])


class Viewer:
    """One car's channels.

    Attributes:
        missed: messages that the pipe had no room for.
    """

    def __init__(self, car: str, body: Body, lane: LaneLines) -> None:
        # The SDK silently closes the channels of a context without references.
        self.context = foxglove.Context()
        self._channels = {t.name: make_channel(car, t, self.context) for t in TOPICS if t.on_bus}
        self._scene = SceneUpdateChannel(SCENE, context=self.context)
        self._frames = FrameTransformsChannel(TRANSFORMS, context=self.context)
        self._body, self._lane = body, make_lane_scene(lane)
        self._views = Views()
        self._seen: dict[str, int] = {}
        self._scene_due_ns = self._lane_due_ns = 0
        self.missed = 0
        self.on_live: Callable[[Mapping[str, float | str]], object] = lambda _live: None

    def show(self, record: PipeRecord) -> None:
        """Pass one record on, with what is drawn of it."""
        name = record.topic.name
        self.missed += record.sequence - self._seen.get(name, record.sequence - 1) - 1
        self._seen[name] = record.sequence
        for each in (record, *self._views.convert(record)):
            channel = self._channels.get(each.topic.name)
            if channel is not None:
                channel.log(each.data, log_time=each.log_time_ns)
        if name == topics.PARAMETERS.name:
            self.on_live(make_live_parameters(decode(Parameters, record.data)))
        if name == topics.MODEL.name:
            self.on_live(make_learnt_parameters(decode(Model, record.data)))
        if name == topics.STATE.name and record.log_time_ns >= self._scene_due_ns:
            self._scene_due_ns = record.log_time_ns + SCENE_NS
            self._draw(decode(StateMessage, record.data), record.log_time_ns)

    def _draw(self, state: StateMessage, log_ns: int) -> None:
        self._frames.log(make_transform(state), log_time=log_ns)
        self._scene.log(make_car_scene(state, self._body), log_time=log_ns)
        if log_ns >= self._lane_due_ns:
            self._lane_due_ns = log_ns + LANE_NS
            self._scene.log(self._lane, log_time=log_ns)


def make_channel(car: str, topic: Topic, context: foxglove.Context) -> foxglove.Channel:
    """A topic as it stands in a session: CDR with its `ros2msg` text."""
    schema = foxglove.Schema(
        name=type_name(topic.message),
        encoding="ros2msg",
        data=schema_text(topic.message).encode(),
    )
    name = make_session_topic(car, topic)
    return foxglove.Channel(name, message_encoding="cdr", schema=schema, context=context)


def run_viewer(viewer: Viewer, pipe_fd: int) -> None:
    """Show what comes until the pipe closes."""
    buffer = bytearray()
    while data := os.read(pipe_fd, _READ_BYTES):
        buffer += data
        for record in unpack_records(buffer):
            viewer.show(record)


def start_viewer(job: Mapping[str, Any]) -> tuple[Viewer, Any]:
    """The viewer of a job and its server.

    Raises:
        RuntimeError: the address is taken or no address of this machine.
    """
    lane = make_lane(job["lane"], job["half_width"], closed=job["closed"])
    viewer = Viewer(job["car"], Body(**job["body"]), lane)
    known = ReadOnlyParameters(make_parameters(job["parameters"]), _make_ask(job.get("requests")))
    server = foxglove.start_server(
        name=f"steerd {job['car']}",
        host=job["host"],
        port=job["port"],
        capabilities=[Capability.Parameters],
        server_listener=known,
        context=viewer.context,
    )
    viewer.on_live = lambda live: server.publish_parameter_values(known.take(live))
    return viewer, server


def _make_ask(fd: int | None) -> Callable[[str], object] | None:
    """Sends a setting to the run's terminal; what does not fit is dropped."""
    if fd is None:
        return None
    terminal = socket.socket(fileno=fd)
    terminal.setblocking(False)

    def ask(text: str) -> None:
        with contextlib.suppress(OSError):
            terminal.send(text.encode())

    return ask


def main() -> int:
    """Process entry: the job as JSON on standard input, pipe and ready descriptors as arguments."""
    ignore_terminal_signals()
    os.nice(_NICE)
    pipe_fd, ready_fd = int(sys.argv[1]), int(sys.argv[2])
    job = json.loads(sys.stdin.read())
    try:
        viewer, _server = start_viewer(job)
    except (RuntimeError, OSError) as error:
        with contextlib.suppress(OSError):
            os.write(ready_fd, f"--view {job['host']}:{job['port']}: {error}\n".encode())
        return 3
    os.write(ready_fd, b"ready\n")
    os.close(ready_fd)
    run_viewer(viewer, pipe_fd)
    if viewer.missed:
        print(f"note: the viewer missed {viewer.missed} messages", file=sys.stderr)
    sys.stderr.flush()
    # The server's threads may keep the interpreter alive; nothing is left to do.
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
