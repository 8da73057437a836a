"""Core and loop of one run: its VESC and session limits, several starts, and exceptions."""

from types import SimpleNamespace

import pytest

from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.ipc.requests import read_diagnostics
from steerd.daemon.loop.core import LIMITS_TRIES, Core, make_core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.supervisor import LAUNCH_SPEED
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.faults import Fault
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import RequestKind
from steerd.steer_bus.standard import DiagnosticArray
from steerd.vesc_link.commands import GetMcConfTemp, SetMcConfTemp
from tests.safety.rig import Rig, at_phase, twin

MS, NS = 1_000_000, 1_000_000_000


@pytest.fixture(scope="module")
def plan():
    options = RunOptions(car_file="", path="line", speed=1.0, simulated=True)
    return make_plan(options, real=RunId(1, 0, leased=True))


def ready() -> Rig:
    rig = twin(at_phase("P1"))
    rig.reach(SupervisorState.READY)
    return rig


def limit_of(rig: Rig) -> float:
    """What the simulated VESC itself holds [ERPM]."""
    return rig.run.world.vesc.motor.limits.erpm_max


def test_a_vesc_that_starts_anew_gets_the_session_limits_again():
    rig = ready()
    wanted = rig.run.core.link.limits.erpm_max
    assert limit_of(rig) == pytest.approx(wanted)
    rig.run.world.add_fault(Fault("V15", rig.t_ns, rig.t_ns + 2 * NS))
    rig.until(lambda r: limit_of(r) > 2 * wanted, 3.0)
    rig.go_on(6.0)
    assert limit_of(rig) == pytest.approx(wanted)
    assert not rig.run.core.flags & Flag.UNBOUNDED


def limits(erpm_max: float) -> SimpleNamespace:
    names = SetMcConfTemp.__dataclass_fields__
    return SimpleNamespace(**(dict.fromkeys(names, 1.0) | {"erpm_max": erpm_max, "erpm_min": -1e9}))


def fresh_core(plan) -> tuple[Core, list]:
    core, requests = make_core(plan, ()), []
    core.link.request = requests.append
    return core, requests


def test_a_vesc_that_refuses_the_session_limits_is_tried_thrice_then_reported(plan):
    core, requests = fresh_core(plan)
    for k in range(LIMITS_TRIES + 1):
        assert not core.flags & Flag.UNBOUNDED, k
        core._apply_session_limits(limits(1e9))
    assert [type(a) for a in requests] == [SetMcConfTemp, GetMcConfTemp] * LIMITS_TRIES
    assert core.flags & Flag.UNBOUNDED
    core._apply_session_limits(requests[0])
    assert not core.flags & Flag.UNBOUNDED


def test_one_run_drives_one_vesc(plan):
    core, requests = fresh_core(plan)
    core._check_identity(b"first")
    core._apply_session_limits(limits(1e9))
    own = core.make_shutdown_frames()
    core._check_identity(b"other")
    core._apply_session_limits(limits(1e9))
    assert not core._expected
    assert len(requests) == 2, "the other one is not given our limits"
    assert len(core.make_shutdown_frames()) < len(own), "nor the first one's at the end"
    core._check_identity(b"first")
    assert core._expected


def test_another_vesc_at_the_same_plug_is_not_armed():
    rig = ready()
    rig.run.world.add_fault(Fault("V3", rig.t_ns, rig.t_ns + 60 * NS))
    rig.go_on(8.0)
    assert rig.state in (SupervisorState.INIT, SupervisorState.DISARMED)
    told = decode(DiagnosticArray, rig.notes.last[topics.DIAGNOSTICS.name])
    assert "not the one this run began with" in read_diagnostics(told)["waiting"]


@pytest.mark.parametrize("fault", ["V1", "V4"])
def test_a_blind_stop_ends_though_the_wheels_were_last_seen_turning(fault):
    """A late tick brakes at once; nothing is heard of the wheels after it."""
    rig = twin(at_phase("P5"))
    rig.break_it(fault)
    rig.late_ns = 200 * MS
    rig.reach(SupervisorState.FAULT_LATCHED)
    assert rig.run.core.loop.at_rest


def test_an_emergency_stop_is_left_by_reset_after_the_plug_was_out():
    rig = twin(at_phase("P5"))
    rig.ask(RequestKind.ESTOP)
    rig.go_on(0.3)
    rig.run.world.add_fault(Fault("V1", rig.t_ns, rig.t_ns + 2 * NS))
    rig.go_on(5.0)
    assert rig.state is SupervisorState.ESTOP
    for _ in range(4):
        rig.ask(RequestKind.CLEAR)
        rig.go_on(0.5)
    assert rig.state in (SupervisorState.DISARMED, SupervisorState.READY)


def test_a_second_start_is_as_slow_as_the_first():
    rig = twin(at_phase("P3"))
    core = rig.run.core
    for _ in range(2):
        rig.ask(RequestKind.START)
        rig.reach(SupervisorState.RUNNING)
        assert core.last.supervisor.cap == LAUNCH_SPEED
        assert not core.last.facts & Fact.LAUNCHED
        rig.until(lambda _: core.last.facts & Fact.LAUNCHED)
        rig.ask(RequestKind.STOP)
        rig.reach(SupervisorState.ARMED)
        rig.step()
        assert not core.last.facts & Fact.LAUNCHED


# An exception in the loop: its reason, no recovery without a restart. It brakes: H13 of the matrix.


BROKEN = LookupError("no such gain")


def broken(*_):
    raise BROKEN


def test_one_exception_keeps_the_car_latched_for_good():
    rig = twin(at_phase("P4"))
    loop = rig.run.core.loop
    loop._watch = broken
    rig.step()
    assert "no such gain" in loop.supervisor.reason
    assert rig.run.core.error is BROKEN
    del loop._watch
    rig.reach(SupervisorState.FAULT_LATCHED, 1.0)
    rig.ask(RequestKind.CLEAR)
    rig.go_on(0.5)
    assert rig.state is SupervisorState.FAULT_LATCHED
    assert rig.run.core.flags & Flag.EXCEPTION
