"""A design as a message: the same bits back, and what is no design."""

import pytest

from steerd.controller.learnt import Learnt
from steerd.daemon.loop.design_desk import make_design, make_no_design, read_design
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import decode, encode
from tests.designs import design_for, standard


def test_a_design_comes_back_bit_by_bit():
    design = design_for(standard(), steer_gain=0.98, body_yaw=0.01)
    message = decode(m.Design, encode(make_design(5, 7, 3, design)))
    assert read_design(message) == design
    assert (message.number, message.mono_ns, m.stamp_ns(message.header)) == (3, 5, 12)


def test_the_files_own_design_says_why():
    message = decode(m.Design, encode(make_no_design(5, 7, "a reason")))
    assert read_design(message) is None
    assert message.text == "a reason"


@pytest.mark.parametrize(
    ("columns", "gains"),
    [(0, b""), (10, b""), (10, b"\0" * 79), (8, b"\0" * 64), (121, b"\0" * 968),
     (10, b"\0" * 80 * 401)],
)  # fmt: skip
def test_what_is_no_table_is_refused(columns, gains):
    car = Learnt(*(0.0,) * len(Learnt._fields))
    message = m.Design(m.make_header(0, m.BODY), 0, 1, columns, *car, 0.1, 0.25, "", gains)
    with pytest.raises(ValueError, match="no rows"):
        read_design(message)
