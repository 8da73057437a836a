"""Records on a pipe: packed, split, dropped whole, and never waited for."""

import os
from dataclasses import replace

import pytest

from steerd.daemon.ipc import pipe_records
from steerd.daemon.ipc.pipe_records import Outbox
from steerd.daemon.ipc.requests import pack_request, unpack_request
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode, encode
from tests.blank import blank

MESSAGE = m.OperatorRequest(m.make_header(5, m.BODY), 1, 2, 3, int(m.RequestKind.STOP), "desk")
RECORD = pipe_records.PipeRecord(topics.OPERATOR, 7, 11, 13, encode(MESSAGE), MESSAGE)


def test_records_return_as_they_were_wherever_the_bytes_are_split(pipe):
    reader, found = pipe_records.PipeReader(pipe[0]), []
    for byte in pipe_records.pack_record(RECORD) * 3:
        os.write(pipe[1], bytes([byte]))
        found += reader.take()
    assert found == [replace(RECORD, message=None)] * 3
    assert pipe_records.read_message(found[0]) == pipe_records.read_message(RECORD) == MESSAGE


def test_a_full_pipe_drops_whole_records_and_recovers(pipe):
    reader, writer, sent = pipe_records.PipeReader(pipe[0]), pipe_records.PipeWriter(pipe[1]), 0
    while not writer.dropped:
        writer.write([pipe_records.pack_record(replace(RECORD, sequence=sent))], sent)
        sent += 1
    assert writer.full_since_ns is not None
    before = list(reader.take())
    writer.write([pipe_records.pack_record(replace(RECORD, sequence=sent))], sent)
    assert writer.full_since_ns is None
    numbers = [record.sequence for record in before + list(reader.take())]
    assert len(numbers) == sent + 1 - writer.dropped
    assert numbers == sorted(set(numbers))
    assert all(record.data == RECORD.data for record in before)


def test_a_tick_without_records_tears_none_that_was_taken_in_part(pipe):
    reader, writer = pipe_records.PipeReader(pipe[0]), pipe_records.PipeWriter(pipe[1])
    packed = pipe_records.pack_record(RECORD)
    while not writer.dropped:
        writer.write([packed] * 300, 0)
    assert writer.full_since_ns == 0
    assert list(reader.take())
    for records in ([], [packed] * 3):
        writer.write(records, 1)
    data = os.read(pipe[0], 1 << 20)
    assert len(data) > 3 * len(packed)
    assert len(data) % len(packed) != 0
    assert data.endswith(packed * 3)


def test_a_reader_that_is_gone_costs_one_write_and_no_exception(pipe):
    writer = pipe_records.PipeWriter(pipe[1])
    os.close(pipe[0])
    writer.write([pipe_records.pack_record(RECORD)], 1)
    assert writer.dead
    writer.write([pipe_records.pack_record(RECORD)] * 2, 2)
    assert writer.dropped == 3


# The core's way out: order, numbers, and a message that cannot be encoded.
def test_a_message_that_cannot_be_encoded_is_lost_alone():
    first, second = [], []
    box = Outbox(7, tuple(lambda got, t, to=to: to.append((got, t)) for to in (first, second)))
    for seq in (1, 1 << 32, 2, -1):
        box.post(topics.TICK, blank(m.Tick, seq=seq), 5)
    with pytest.raises(CodecError, match="cannot encode Tick"):
        box.flush(9)
    ((records, t_ns),) = first
    assert t_ns == 9
    assert [decode(m.Tick, record.data).seq for record in records] == [1, 2]
    assert [record.sequence for record in records] == [0, 2], "what was lost leaves a gap"
    assert second == first
    box.flush(10)
    assert len(first) == 1, "what was wrong once is not tried again"
    alone = Outbox(0, ())
    alone.post(topics.TICK, blank(m.Tick, seq=1 << 40), 0)
    alone.flush(0)  # without anybody to tell nothing is kept


def test_log_times_never_go_back():
    sent = []
    box = Outbox(100, (lambda got, t: sent.extend(got),))
    box.post(topics.TICK, blank(m.Tick), 5)
    box.post(topics.TICK, blank(m.Tick), 3, valid_ns=2)
    box.flush(5)
    assert [(r.log_time_ns, r.publish_time_ns) for r in sent] == [(105, 105), (105, 102)]


@pytest.mark.parametrize("data", [b"", b"x", b"\0\0", bytes(range(256))])
def test_a_request_returns_as_it_was_and_one_without_a_name_is_none(data):
    assert unpack_request(pack_request("operator", data)) == ("operator", data)
    assert unpack_request(data.partition(b"\0")[0]) == ("", b"")
