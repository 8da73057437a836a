"""Session files are the mcap library's, byte by byte."""

import io

import numpy as np
from mcap.records import Attachment  # noqa: TID251
from mcap.writer import Writer  # noqa: TID251

from steerd.steer_bus.container_write import ContainerWriter


def test_bytes_are_the_librarys():
    rng = np.random.default_rng(1)
    theirs, ours = io.BytesIO(), io.BytesIO()
    library, writer = Writer(theirs, enable_data_crcs=True), ContainerWriter(ours, "ros2")
    library.start("ros2", "steerd")
    for name, values in (("one", {"a": "b", "c": ""}), ("two", {})):
        library.add_metadata(name, values)
        writer.add_metadata(name, values)
    library.add_attachment(3, 4, "car.toml", "application/toml", b"mass")
    writer.add_attachment(Attachment(3, 4, "car.toml", "application/toml", b"mass"))
    for k in range(3):
        schema = library.register_schema(f"s{k}", "ros2msg", bytes(k))
        assert writer.add_schema(f"s{k}", "ros2msg", bytes(k)) == schema
        channel = library.register_channel(f"/t{k}", "cdr", schema, {"k": "v"})
        assert writer.add_channel(f"/t{k}", "cdr", schema, {"k": "v"}) == channel
    log_ns = 1000
    for k in range(20_000):  # three chunks by their size, more by their flushes
        log_ns += int(rng.integers(-50, 1000))
        message = int(rng.integers(1, 4)), log_ns, rng.bytes(100), log_ns + 1, k
        library.add_message(*message)
        writer.add_message(*message)
        if k % 3001 == 0:
            library.flush()
            writer.flush()
    library.finish()
    writer.finish()
    assert ours.getvalue() == theirs.getvalue()
