"""A small recorded drive: deterministic, with every kind of own message."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from steerd.steer_bus.codec import encode, type_name
from steerd.steer_bus.fields import Array, Blob, Scalar, Text, message_fields
from steerd.steer_bus.messages import OWN_MESSAGES, WORLD, make_header
from steerd.steer_bus.session import AttachedFile, SessionWriter
from steerd.steer_bus.standard import Header

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 5_000_000


def make_value(kind, rng):
    if isinstance(kind, Text):
        return "x" * int(rng.integers(0, 9))
    if isinstance(kind, Blob):
        return rng.bytes(int(rng.integers(0, 30)))
    if isinstance(kind, Array):
        return tuple(rng.normal(size=kind.count).tolist())
    if isinstance(kind, Scalar):
        return float(rng.normal()) if kind.code in "df" else int(rng.integers(0, 100))
    return make_message(kind.cls, rng)


def make_message(cls, rng, stamp_ns=START_NS):
    values = {}
    for field in message_fields(cls):
        nested = getattr(field.kind, "cls", None)
        if nested is Header:
            values[field.name] = make_header(stamp_ns, WORLD)
        else:
            values[field.name] = make_value(field.kind, rng)
    return cls(**values)


@dataclasses.dataclass(frozen=True)
class Drive:
    path: Path
    messages: dict
    order: list


TOPIC_OF = {
    cls: f"/steerd/car1/{type_name(cls).rpartition('/')[2].lower()}" for cls in OWN_MESSAGES
}


def write_drive(path, ticks=200, seed=0):
    rng = np.random.default_rng(seed)
    writer = SessionWriter(
        path,
        {topic: cls for cls, topic in TOPIC_OF.items()},
        {"steerd.session": {"car": "car1"}, "steerd.vehicle": {"mass_kg": "3.1"}},
        [AttachedFile("car.toml", "application/toml", b"mass_kg = 3.1\n")],
        START_NS,
    )
    messages = {topic: [] for topic in TOPIC_OF.values()}
    order = []
    for tick in range(ticks):
        stamp = START_NS + tick * PERIOD_NS
        for cls, topic in TOPIC_OF.items():
            message = make_message(cls, rng, stamp)
            messages[topic].append(message)
            order.append((topic, encode(message)))
            writer.write(topic, encode(message), stamp, stamp - 1000)
        writer.tick(tick * PERIOD_NS)
    writer.finish({"reason": "test"})
    return Drive(path, messages, order)


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive") / "drive.mcap")


@pytest.fixture(scope="session")
def topic_of():
    return TOPIC_OF


@pytest.fixture(scope="session")
def make_drive():
    return write_drive


@pytest.fixture(scope="session")
def make_random_message():
    return make_message
