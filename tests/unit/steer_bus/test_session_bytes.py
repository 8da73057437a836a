"""Session files are the mcap library's, byte by byte."""

import io

import numpy as np
from mcap.writer import Writer  # noqa: TID251

from steerd.steer_bus.session import McapWriter


def write(writer):
    rng, log_ns = np.random.default_rng(1), 1000
    for name, values in (("one", {"a": "b", "c": ""}), ("two", {})):
        writer.add_metadata(name, values)
    writer.add_attachment(3, 4, "car.toml", "application/toml", b"mass")
    for k in range(3):
        schema = writer.register_schema(f"s{k}", "ros2msg", bytes(k))
        writer.register_channel(f"/t{k}", "cdr", schema, {"k": "v"})
    for k in range(20_000):  # three chunks by their size, more by their flushes
        log_ns += int(rng.integers(-50, 1000))
        writer.add_message(int(rng.integers(1, 4)), log_ns, rng.bytes(100), log_ns + 1, k)
        if k % 3001 == 0:
            writer.flush()
    writer.finish()


def test_bytes_are_the_librarys():
    theirs, ours = io.BytesIO(), io.BytesIO()
    library = Writer(theirs, enable_data_crcs=True)
    library.start("ros2", "steerd")
    write(library)
    write(McapWriter(ours, "ros2"))
    assert ours.getvalue() == theirs.getvalue()


def test_no_list_of_the_librarys_grows_with_the_chunks():
    writer = McapWriter(io.BytesIO(), "ros2")
    channel = writer.register_channel("/t", "cdr", 0)
    for k in range(100):
        writer.add_message(channel, k, b"", k)
        writer.flush()
    assert max(len(value) for value in vars(writer).values() if isinstance(value, list)) == 0
