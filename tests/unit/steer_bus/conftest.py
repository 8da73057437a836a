"""A small recorded drive: deterministic, with every kind of own message."""

import dataclasses
from collections import namedtuple

import numpy as np
import pytest

from steerd.steer_bus.codec import encode
from steerd.steer_bus.fields import type_name
from steerd.steer_bus.messages import OWN_MESSAGES, WORLD, make_header
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.session_read import SessionError
from tests.blank import drawn

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 5_000_000


Drive = namedtuple("Drive", "path messages order")
TOPIC_OF = {c: f"/steerd/car1/{type_name(c).rpartition('/')[2].lower()}" for c in OWN_MESSAGES}


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    path, rng = tmp_path_factory.mktemp("drive") / "drive.mcap", np.random.default_rng(0)
    writer = SessionWriter(
        path, {topic: cls for cls, topic in TOPIC_OF.items()},
        {"steerd.session": {"car": "car1"}, "steerd.vehicle": {"mass_kg": "3.1"}},
        {"car.toml": b"mass_kg = 3.1\n"}, START_NS,
    )  # fmt: skip
    messages, order = {topic: [] for topic in TOPIC_OF.values()}, []
    for tick in range(200):
        stamp = START_NS + tick * PERIOD_NS
        for cls, topic in TOPIC_OF.items():
            message = dataclasses.replace(drawn(cls, rng), header=make_header(stamp, WORLD))
            messages[topic].append(message)
            order.append((topic, encode(message)))
            writer.write(topic, encode(message), stamp, stamp - 1000)
        writer.tick(tick * PERIOD_NS)
    writer.finish({"reason": "test"})
    return Drive(path, messages, order)


def refusal(call, *args):
    """Code and exit code of an error."""
    with pytest.raises(SessionError) as caught:
        call(*args)
    return caught.value.code, caught.value.exit_code
