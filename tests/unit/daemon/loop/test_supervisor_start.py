"""How the supervisor begins: field by field, because most of them matter only much later."""

from steerd.daemon.loop.supervisor import (
    NEVER,
    OPEN_FRAMES,
    SupervisorMemory,
    make_supervisor_memory,
)
from steerd.daemon.loop.transitions import SupervisorState


def test_it_begins_with_nothing_shown_nothing_held_and_no_speed():
    begun = make_supervisor_memory(5)
    expected = SupervisorMemory(
        SupervisorState.INIT, 5, 5, "started", NEVER, NEVER, NEVER, 0.0, False, False, OPEN_FRAMES
    )
    assert begun == expected
    for field, value in zip(SupervisorMemory._fields, begun, strict=True):
        assert type(value) is type(getattr(expected, field)), field
    assert (NEVER, OPEN_FRAMES) == (-1, 3)
