"""The gateway process: the car's messages onto the bus, operators' and controllers' requests back.

The core never waits for it: messages come through a pipe that drops when full, requests go into a
socket that the core reads. What decodes is passed on, stops first, under the badge of its lease;
whether it is obeyed is the core's to decide. With `--ros-domain` the car is also a ROS 2 node for
rmw_zenoh: its topics once more, under ROS's keys.
"""

# Why: docs/decisions/safety.md#d112

import contextlib
import socket
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord
from steerd.daemon.ipc.requests import REQUEST_MAX, make_badge, pack_request
from steerd.daemon.loop.lease import VALID_MS
from steerd.daemon.process.bus_operator import STOPS
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.views import Views
from steerd.daemon.settings.run_options import ControllerKind, RunOptions, decode_options
from steerd.mocap_link.mocap_url import parse_mocap_url
from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.lab import load_lab
from steerd.steer_bus.messages import BODY, Actuation, DriveCommand
from steerd.steer_bus.standard import AckermannDrive, AckermannDriveStamped
from steerd.steer_bus.topics import BusError, Keep
from steerd.steer_bus.zenoh_bus import Profile, Subscription, ZenohBus

DRIVE_NAME = "drive"  # what went to the motor controller, as `ackermann_msgs/AckermannDriveStamped`
_FIRST_ENTITY = 10  # entity number of the first publisher


class RosBridge:
    """One node ``steerd_<car>`` with a publisher for each topic that the car sends."""

    def __init__(self, bus: ZenohBus, car: str, domain: int) -> None:
        self._bus = bus
        node = f"steerd_{car}"
        published = [t for t in topics.TOPICS if t.on_bus and t.direction == "out"]
        sent = {t.name: t.message for t in published} | {DRIVE_NAME: AckermannDriveStamped}
        bus.declare_alive(topics.make_node_token(domain, bus.zid, node))
        self._keys: dict[str, str] = {}
        for entity, (name, cls) in enumerate(sent.items(), _FIRST_ENTITY):
            topic = topics.make_key(car, name)
            key = self._keys[name] = topics.make_ros_key(domain, topic, cls)
            token = topics.make_publisher_token(domain, bus.zid, entity, node, topic, cls)
            bus.name_publisher(key, topics.make_gid(token))
            bus.declare_alive(token)

    def publish(self, record: PipeRecord) -> None:
        """Publish one record under its ROS key; an actuation also as a drive command."""
        self._put(record.topic.name, record.data)
        if record.topic.name == topics.ACTUATION.name:
            sent = decode(Actuation, record.data)
            drive = AckermannDrive(sent.steer, 0.0, sent.speed, 0.0, 0.0)  # rates: 0, unset
            self._put(DRIVE_NAME, encode(AckermannDriveStamped(sent.header, drive)))

    def _put(self, name: str, data: bytes) -> None:
        key = self._keys.get(name)
        if key is not None:
            with contextlib.suppress(BusError):
                self._bus.publish(key, data)


class RosDrive:
    """`/drive` of ROS 2 nodes as an external controller's commands.

    Each publisher has a lease of its own: a second one is refused while the first one drives.
    """

    def __init__(self, bus: ZenohBus, domain: int, boot_id: int) -> None:
        key = topics.make_ros_key(domain, DRIVE_NAME, AckermannDriveStamped).rpartition("/")[0]
        topic = topics.Topic(DRIVE_NAME, AckermannDriveStamped, "in")
        # ROS 2 Humble writes no hash of the type
        self._heard = bus.subscribe(f"{key}/*", _DEPTH, make_keep(topic))
        self._boot_id, self._seq = boot_id, 0

    def take(self) -> Iterator[DriveCommand]:
        """The commands that came since the last call."""
        for sample in self._heard.poll():
            message = decode(AckermannDriveStamped, sample.data)
            header = replace(message.header, frame_id=BODY)
            self._seq += 1
            yield DriveCommand(
                header, self._boot_id, make_badge(sample.sender.hex(), 1), sample.sent_ns,
                self._seq, VALID_MS, message.drive.steering_angle, message.drive.speed,
            )  # fmt: skip


_POLL_MS = 4  # longest time that a request waits here [ms]
_DEPTH = 16  # requests kept of each topic between two polls
_INWARD = (topics.STOP, topics.OPERATOR, topics.DRIVE, topics.SET_PARAMETERS, topics.HEARTBEAT_BACK)
"""What comes from the bus, in the order in which it is passed on."""


def make_keep(topic: topics.Topic) -> Keep:
    """Which bytes are requests of a topic: those that decode; under `STOP`, stops."""

    def keep(data: bytes) -> bool:
        if len(data) > REQUEST_MAX:
            return False
        try:
            request = decode(topic.message, data)
        except CodecError:
            return False
        return topic is not topics.STOP or request.kind in STOPS

    return keep


def seal(topic: topics.Topic, data: bytes, who: str) -> bytes:
    """A request for the core: with its lease's badge, and the name that a certificate proves."""
    request = decode(topic.message, data)
    request = replace(request, lease_id=make_badge(who, request.lease_id))
    named = who and hasattr(request, "operator")
    return encode(replace(request, operator=who) if named else request)


class Gateway:
    """One car on the bus, and in ROS's graph if there is a bridge."""

    def __init__(
        self,
        bus: ZenohBus,
        car: str,
        pose_key: str | None,
        ros: RosBridge | None = None,
        ros_drive: RosDrive | None = None,
    ) -> None:
        self._bus = bus
        self._ros, self._ros_drive = ros, ros_drive
        self._car = car
        self._views = Views()
        self._requests: list[tuple[topics.Topic, Subscription]] = [
            (topic, bus.subscribe(topics.make_key(car, topic, "**"), _DEPTH, make_keep(topic)))
            for topic in _INWARD
        ]
        self._plain = [(topics.HEARTBEAT, bus.subscribe(topics.make_key(car, topics.HEARTBEAT)))]
        if pose_key is not None:
            self._plain.append((topics.EXTERNAL_POSE, bus.subscribe(pose_key, _DEPTH)))
        bus.declare_alive(topics.make_key(car, topics.ALIVE))
        schemas = topics.schema_replies(car)
        bus.serve(topics.make_key(car, "schema/**"), schemas.get)
        self._model: bytes | None = None
        bus.serve(topics.make_key(car, topics.LAST_MODEL), lambda _: self._model)

    def publish(self, records: Iterable[PipeRecord]) -> None:
        """Publish records, each with its standard ROS message."""
        for record in records:
            for each in (record, *self._views.convert(record)):
                if each.topic is topics.MODEL:
                    self._model = each.data
                if each.topic.direction == "out":
                    with contextlib.suppress(BusError):
                        self._bus.publish(topics.make_key(self._car, each.topic), each.data)
                    if self._ros is not None:
                        self._ros.publish(each)

    def forward_requests(self, core: socket.socket) -> None:
        """Send what arrived to the core; what does not fit is dropped."""
        for topic, subscription in self._requests:
            known = topics.OPERATOR if topic is topics.STOP else topic
            for sample in subscription.poll():
                who = sample.key.removeprefix(topics.make_key(self._car, topic)).removeprefix("/")
                _send(core, known, seal(topic, sample.data, who))
        for command in self._ros_drive.take() if self._ros_drive else ():
            _send(core, topics.DRIVE, encode(command))
        for topic, subscription in self._plain:
            for sample in subscription.poll():
                if len(sample.data) <= REQUEST_MAX:
                    _send(core, topic, sample.data)


def _send(core: socket.socket, topic: topics.Topic, data: bytes) -> None:
    with contextlib.suppress(BlockingIOError):
        core.send(pack_request(topic.name, data))


def run_gateway(
    gateway: Gateway, records: PipeReader, core: socket.socket, reports: PipeReader
) -> None:
    """Publish and pass on until the core's pipe closes."""
    while records.fd is not None:
        records.wait(_POLL_MS)
        gateway.publish(records.take())
        gateway.publish(reports.take())
        try:
            gateway.forward_requests(core)
        except OSError:
            return


def serve(job: Job) -> int:
    """The process; it ends with the core's pipe."""
    options, core = decode_options(job.about["options"]), socket.socket(fileno=job.fds["requests"])
    pose_key, (boot_id, *_) = find_pose_key(options), job.about["run"]
    core.setblocking(False)
    try:
        lab = load_lab(Path(options.lab)) if options.lab else None
        profile = Profile(
            True, options.listen, lab, insecure_lan=options.insecure_lan, pose_key=pose_key
        )
        with ZenohBus(profile) as bus:
            domain = options.ros_domain
            ros = None if domain is None else RosBridge(bus, options.car, domain)
            driven = options.controller is ControllerKind.ROS2
            drive = RosDrive(bus, domain or 0, boot_id) if driven else None
            gateway = Gateway(bus, options.car, pose_key, ros, drive)
            job.say_ready()
            reports = PipeReader(job.fds.get("reports"))
            run_gateway(gateway, PipeReader(job.fds["pipe"]), core, reports)
    except BusError as error:
        taken = "already in use" in str(error)
        hint = "end that one, or --listen tcp/127.0.0.1:7448" if taken else ""
        raise SteerdError(str(error), hint, ExitCode.UNREACHABLE) from None
    return 0


def find_pose_key(options: RunOptions) -> str | None:
    """Key of the bus on which poses come; None where mocap is no program on the bus."""
    try:
        url = parse_mocap_url(options.mocap or "")
    except ValueError:  # the core says what is wrong with the address
        return None
    # rmw_zenoh's keys are domain, topic, type and its hash
    return f"{options.ros_domain or 0}/{url.key}/*/*" if url.scheme == "ros2" else url.key or None


if __name__ == "__main__":
    run_process(serve)
