"""Other people's tools open our sessions: mcap-ros2-support sees what was written."""

from operator import attrgetter

import numpy as np
import pytest
from mcap.reader import make_reader  # noqa: TID251
from mcap_ros2.decoder import DecoderFactory

from steerd.steer_bus.codec import encode
from steerd.steer_bus.fields import Nested, Scalar, Sized, leaves_of, type_name
from steerd.steer_bus.messages import OWN_MESSAGES
from steerd.steer_bus.session import SessionWriter
from steerd.steer_bus.standard import STANDARD_MESSAGES
from tests.blank import drawn

ALL = (*OWN_MESSAGES, *STANDARD_MESSAGES)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    rng = np.random.default_rng(3)
    path = tmp_path_factory.mktemp("contract") / "all.mcap"
    topics = {f"/all/{type_name(cls).replace('/', '_').lower()}": cls for cls in ALL}
    writer = SessionWriter(path, topics, {"steerd.session": {"car": "c"}})
    written = []
    for log_ns in range(5):
        for topic, cls in topics.items():
            message = drawn(cls, rng)
            writer.write(topic, encode(message), log_ns)
            written.append((topic, log_ns, message))
    return writer.finish({"reason": "test"}), written


def assert_same(theirs, ours):
    for leaf in leaves_of(type(ours)):
        value, expected = (attrgetter(leaf.name)(message) for message in (theirs, ours))
        match leaf.kind:
            case Nested():
                for a, b in zip(value, expected, strict=True):
                    assert_same(a, b)
            case Sized(is_text=False):
                assert list(value) == list(expected)
            case Scalar(count=count) if count:
                assert list(value) == list(expected)
            case Scalar(ros="byte") if isinstance(value, bytes):
                assert ord(value) == expected
            case _:
                assert value == expected


def test_mcap_ros2_decodes_every_message(recorded):
    path, written = recorded
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [
            (channel.topic, raw.log_time, message)
            for _, channel, raw, message in reader.iter_decoded_messages(log_time_order=False)
        ]
    assert [(topic, stamp) for topic, stamp, _ in found] == [(t, s) for t, s, _ in written]
    for (_, _, theirs), (_, _, ours) in zip(found, written, strict=True):
        assert_same(theirs, ours)


def test_the_summary_counts_what_was_written(recorded):
    path, written = recorded
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        names = [item.name for item in reader.iter_metadata()]
    assert summary is not None
    assert summary.statistics.message_count == len(written)
    assert names == ["steerd.session", "steerd.end"]
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
