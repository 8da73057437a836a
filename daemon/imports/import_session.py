"""The session that an import writes: samples become steerd's own messages.

Times are the log's own [ns]; `epoch_ns` places them in UNIX time. What a log does not hold is NaN,
or -1 for a whole number, as in :mod:`steerd.steer_bus.messages`.
"""

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError, make_session_error
from steerd.daemon.imports.import_map import ImportMap
from steerd.mocap_link import frame as frames
from steerd.mocap_link.frame import FrameConfig, PlanarPose, Quat, Vec3
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import SessionError
from steerd.steer_bus.topics import ACTUATION, MOCAP, Topic, make_session_topic
from steerd.version import VERSION


class Sample(NamedTuple):
    """One value of a stream."""

    topic: Topic
    t_ns: int  # time of validity, in the log's own time
    log_ns: int  # when it was logged, in the log's own time
    message: Any


@dataclass(frozen=True)
class ImportReport:
    """Result of an import."""

    path: Path  # the session
    counts: dict[str, int]  # messages by topic name
    notes: tuple[str, ...] = ()  # oddities of the log, one line each
    remarks: tuple[str, ...] = ()  # what was chosen, and what the log lacks

    @property
    def is_drive(self) -> bool:
        """Whether it holds what identify and diagnose need: poses and the commands to the car."""
        return all(self.counts.get(topic.name) for topic in (MOCAP, ACTUATION))


def check_output(out: Path) -> None:
    """Check the output name before the work.

    Raises:
        SteerdError: it exists, or does not end in `.mcap`.
    """
    if out.suffix != ".mcap":
        raise UsageError(f"{out}: a session's name ends in .mcap", f"-o {out.with_suffix('.mcap')}")
    if out.exists():
        raise UsageError(f"{out} exists and is never overwritten", "choose another name with -o")


def hash_file(path: Path) -> str:
    """SHA-256 of a file, or of a bag folder's files in order of their names.

    Raises:
        OSError: it cannot be read.
    """
    digest = hashlib.sha256()
    for part in sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]:
        with part.open("rb") as file:
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()


def write_import(
    out: Path,
    source: Path,
    the_map: ImportMap,
    topics: Iterable[Topic],
    samples: Iterable[Sample],
    notes: Counter[str],
) -> ImportReport:
    """Write the whole session of a log's samples, or leave nothing behind.

    `notes` are oddities of the log that do not stop an import, counted while samples come.

    Raises:
        SteerdError: the source cannot be read or holds no sample, the output's name cannot be used
            (see `check_output`), or the disk does not take it.
    """
    check_output(out)
    counts = {topic.name: 0 for topic in topics}
    names = {topic.name: make_session_topic(the_map.car, topic) for topic in topics}
    classes = {names[topic.name]: topic.message for topic in topics}
    metadata, files = _make_metadata(source, the_map), {"map.toml": the_map.text.encode()}
    try:
        writer = SessionWriter(out, classes, metadata, files, the_map.epoch_ns)
    except SessionError as error:
        raise make_session_error(error) from error
    try:
        for sample in samples:
            log_ns, valid_ns = sample.log_ns + the_map.epoch_ns, sample.t_ns + the_map.epoch_ns
            writer.write(names[sample.topic.name], encode(sample.message), log_ns, valid_ns)
            counts[sample.topic.name] += 1
        if not writer.count:
            what = f"{source.name} holds no sample of what the map names"
            raise SteerdError(what, "are these columns empty?")
        writer.finish({"reason": "imported", "messages": str(writer.count)})
    except BaseException as error:
        writer.abandon()
        writer.partial.unlink(missing_ok=True)
        if isinstance(error, SessionError):
            what = str(error).removesuffix(f" ({error.hint})")
            raise SteerdError(what, "free some space", ExitCode.UNREADABLE) from error
        raise
    return ImportReport(out, counts, tuple(f"{count} {what}" for what, count in notes.items()))


def _make_metadata(source: Path, the_map: ImportMap) -> dict[str, dict[str, str]]:
    """Where the session is from, and what the log's electrical rpm mean where somebody said so."""
    about = {
        "mode": "import",
        "car": the_map.car,
        "source": source.name,
        "source_sha256": hash_file(source),
        "epoch_ns": str(the_map.epoch_ns),
        "comment": the_map.comment,
        "steerd_version": VERSION,
    }
    if (spec := the_map.vesc) is None:
        return {"steerd.session": about}
    scaling = {"erpm_gain": repr(spec.erpm_gain), "erpm_offset": repr(spec.erpm_offset)}
    return {"steerd.session": about, "steerd.scaling": scaling}


@dataclass
class MessageMaker:
    """Samples of one log as messages."""

    epoch_ns: int  # UNIX time of the log's time zero [ns]
    # From the recorded body to the centre of gravity; None changes nothing
    frame: FrameConfig | None = None
    _commands: int = 0
    _poses: int = 0

    def pose(self, t_ns: int, arrival_ns: int, position: Vec3, quaternion: Quat) -> m.MocapPose:
        """A body pose.

        Raises:
            ValueError: the position is not finite or the quaternion has no direction.
        """
        planar = frames.make_planar_pose(self.frame or FrameConfig(), position, quaternion)
        return self._mocap(t_ns, arrival_ns, position, quaternion, planar)

    def planar_pose(self, t_ns: int, x: float, y: float, yaw: float) -> m.MocapPose:
        """A pose on the floor; without a frame its numbers stay exactly as they are."""
        position, quaternion = frames.make_body_pose(FrameConfig(), x, y, yaw)
        planar = PlanarPose(x, y, frames.wrap_angle(yaw), nan, nan)
        if self.frame is not None:
            planar = frames.make_planar_pose(self.frame, position, quaternion)
        return self._mocap(t_ns, t_ns, (x, y, nan), quaternion, planar)

    def _mocap(
        self, t_ns: int, arrival_ns: int, position: Vec3, quaternion: Quat, planar: PlanarPose
    ) -> m.MocapPose:
        frame, self._poses = self._poses, self._poses + 1
        header = m.make_header(t_ns + self.epoch_ns, m.WORLD)
        stamps = (t_ns, arrival_ns, max(t_ns, 0), frame, 0, 1)
        return m.MocapPose(header, *stamps, *position, *quaternion, nan, *planar, "")

    def command(self, t_ns: int, steer: float, speed: float) -> m.Actuation:
        """A command to steering and drive; NaN where the log has none."""
        self._commands += 1
        mode = m.ActuationMode.SPEED
        return m.Actuation(self._body(t_ns), self._commands, mode, steer, speed, nan, b"")

    def telemetry(self, t_ns: int, erpm: float, values: tuple[float, ...] = ()) -> m.VescTelemetry:
        """A VESC's electrical rpm, and its v_in to vq in the message's order where known."""
        floats = (*values, *(nan,) * (10 - len(values)))
        return m.VescTelemetry(
            self._body(t_ns), t_ns, t_ns, -1, round(erpm), -1, -1, -1, -1, *floats
        )

    def wheel(self, t_ns: int, speed: float) -> m.WheelSpeed:
        """A wheel's speed [m/s]."""
        return m.WheelSpeed(self._body(t_ns), t_ns, speed)

    def throttle(self, t_ns: int, throttle: float) -> m.Throttle:
        """An open-loop motor command."""
        return m.Throttle(self._body(t_ns), t_ns, throttle)

    def gyro(self, t_ns: int, yaw_rate: float) -> m.VescImu:
        """A yaw rate [rad/s]."""
        gyro = (nan, nan, yaw_rate)
        return m.VescImu(self._body(t_ns), t_ns, t_ns, nan, nan, nan, *gyro, nan, nan, nan, nan)

    def _body(self, t_ns: int) -> m.Header:
        return m.make_header(t_ns + self.epoch_ns, m.BODY)
