"""The core's way out: order, numbers, and a message that cannot be encoded."""

import pytest

from steerd.daemon.ipc.outbox import Outbox
from steerd.steer_bus import topics
from steerd.steer_bus.codec import CodecError, decode
from steerd.steer_bus.messages import BODY, Tick, make_header


def tick(seq):
    return Tick(make_header(0, BODY), 0, 0, 0, seq, 0)


def test_a_message_that_cannot_be_encoded_is_lost_alone():
    first, second = [], []
    box = Outbox(7, tuple(lambda got, t, to=to: to.append((got, t)) for to in (first, second)))
    for seq in (1, 1 << 32, 2, -1):
        box.post(topics.TICK, tick(seq), 5)
    with pytest.raises(CodecError, match="cannot encode Tick"):
        box.flush(9)
    ((records, t_ns),) = first
    assert t_ns == 9
    assert [decode(Tick, record.data).seq for record in records] == [1, 2]
    assert [record.sequence for record in records] == [0, 2], "what was lost leaves a gap"
    assert second == first
    box.flush(10)
    assert len(first) == 1, "what was wrong once is not tried again"


def test_log_times_never_go_back():
    sent = []
    box = Outbox(100, (lambda got, t: sent.extend(got),))
    box.post(topics.TICK, tick(1), 5)
    box.post(topics.TICK, tick(2), 3, valid_ns=2)
    box.flush(5)
    assert [(r.log_time_ns, r.publish_time_ns) for r in sent] == [(105, 105), (105, 102)]


def test_without_anybody_to_tell_nothing_is_kept():
    box = Outbox(0, ())
    box.post(topics.TICK, tick(1 << 40), 0)
    box.flush(0)
