"""An exception in the loop: the brake, the reason, and no recovery without a restart."""

from operator import attrgetter

import pytest

from steerd.daemon.loop.core import describe_error
from steerd.daemon.loop.loop import Flag
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus.messages import RequestKind
from tests.safety.judge import Effort, read_motor_frames
from tests.safety.rig import at_phase, twin


class BrokenError(RuntimeError):
    pass


def broken(*_):
    raise BrokenError("no such gain")


@pytest.mark.parametrize("part", ["_make_wish", "_watching.look", "_make_facts"])
def test_whatever_raises_the_same_tick_brakes(part):
    rig = twin(at_phase("P4"))
    broken_ns = rig.t_ns
    loop, (*inside, name) = rig.run.core.loop, part.split(".")
    setattr(attrgetter(*inside)(loop) if inside else loop, name, broken)
    rig.step()
    assert rig.state is SupervisorState.FAULT_STOP
    after = [f for f in read_motor_frames(rig.run.world.log) if f.t_ns >= broken_ns]
    assert [frame.effort for frame in after] == [Effort.BRAKE]
    assert "no such gain" in rig.run.core.loop.supervisor.reason
    assert isinstance(rig.run.core.error, BrokenError)


def test_one_exception_keeps_the_car_latched_for_good():
    rig = twin(at_phase("P4"))
    loop = rig.run.core.loop
    loop._make_wish = broken
    rig.step()
    del loop._make_wish
    rig.reach(SupervisorState.FAULT_LATCHED, 1.0)
    rig.ask(RequestKind.CLEAR)
    for _ in range(50):
        rig.step()
    assert rig.state is SupervisorState.FAULT_LATCHED
    assert rig.run.core.flags & Flag.EXCEPTION


def test_an_error_is_described_with_its_place():
    with pytest.raises(BrokenError) as caught:
        broken()
    assert describe_error(caught.value).startswith("BrokenError at broken:")
    assert describe_error(ValueError("x")) == "ValueError: x"
