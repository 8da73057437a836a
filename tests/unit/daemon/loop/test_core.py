"""One run, one VESC, its session limits, and what is known of the car when it falls silent."""

from types import SimpleNamespace

import pytest

from steerd.daemon.assembly.build import make_core, make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.loop.core import LIMITS_TRIES, Core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.loop.outgoing import make_mocap
from steerd.daemon.loop.perception import NO_TELEMETRY
from steerd.daemon.loop.transitions import Request, SupervisorState
from steerd.daemon.offline.virtual import VirtualRun, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.mocap_link.source import Pose
from steerd.sim_hw.plant.faults import Fault
from steerd.steer_bus.quick_values import changed
from steerd.vesc_link.commands import GetMcConfTemp, SetMcConfTemp

MS, NS = 1_000_000, 1_000_000_000


@pytest.fixture(scope="module")
def plan():
    return make_plan(RunOptions(car_file="", path="line", speed=1.0, simulated=True))


def until(run: VirtualRun, holds, limit_s: float) -> None:
    end = run.t_ns + round(limit_s * NS)
    while run.t_ns < end and not holds():
        run.step()


def state_of(run: VirtualRun) -> SupervisorState:
    return run.core.loop.supervisor.state


def driving(plan) -> VirtualRun:
    """A run whose car moves."""
    run = make_virtual_run(plan)
    until(run, lambda: state_of(run) is SupervisorState.READY, 20.0)
    run.core.loop._requests_pending |= Request.ARM
    until(run, lambda: state_of(run) is SupervisorState.ARMED, 5.0)
    run.core.loop._requests_pending |= Request.START
    until(run, lambda: run.core.loop.perception.wheel_speed > 0.4, 5.0)
    assert state_of(run) is SupervisorState.RUNNING
    return run


def limit_of(run: VirtualRun) -> float:
    """What the simulated VESC itself holds [ERPM]."""
    return run.world.vesc.motor.limits["erpm_max"]


def test_a_vesc_that_starts_anew_gets_the_session_limits_again(plan):
    run = make_virtual_run(plan)
    until(run, lambda: state_of(run) is SupervisorState.READY, 20.0)
    wanted = run.core.link.limits.erpm_max
    assert limit_of(run) == pytest.approx(wanted)
    run.world.add_fault(Fault("V15", run.t_ns, run.t_ns + 2 * NS))
    until(run, lambda: limit_of(run) > 2 * wanted, 3.0)
    until(run, lambda: False, 6.0)
    assert limit_of(run) == pytest.approx(wanted)
    assert not run.core.flags & Flag.UNBOUNDED


def limits(erpm_max: float) -> SimpleNamespace:
    names = SetMcConfTemp.__dataclass_fields__
    return SimpleNamespace(**(dict.fromkeys(names, 1.0) | {"erpm_max": erpm_max, "erpm_min": -1e9}))


def fresh_core(plan) -> tuple[Core, list]:
    core, requests = make_core(plan, 1, 0, (), leased=True), []
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


def test_another_vesc_at_the_same_plug_is_not_armed(plan):
    run = make_virtual_run(plan)
    until(run, lambda: state_of(run) is SupervisorState.READY, 20.0)
    run.world.add_fault(Fault("V3", run.t_ns, run.t_ns + 60 * NS))
    until(run, lambda: False, 8.0)
    assert state_of(run) in (SupervisorState.INIT, SupervisorState.DISARMED)
    last = run.core.last
    assert "not the one this run began with" in run.core._describe_waiting(last.waiting)


@pytest.mark.parametrize("fault", ["V1", "V4"])
def test_a_blind_stop_ends_though_the_wheels_were_last_seen_turning(plan, fault):
    run = driving(plan)
    run.world.add_fault(Fault(fault, run.t_ns, 1 << 62))

    def fail(*_):
        raise RuntimeError("controller")

    run.core.loop._make_wish = fail
    until(run, lambda: state_of(run) is SupervisorState.FAULT_LATCHED, 6.0)
    assert state_of(run) is SupervisorState.FAULT_LATCHED
    assert run.core.loop.at_rest


def test_an_emergency_stop_is_left_by_reset_after_the_plug_was_out(plan):
    run = driving(plan)
    run.core.loop._requests_pending |= Request.ESTOP
    until(run, lambda: False, 0.3)
    run.world.add_fault(Fault("V1", run.t_ns, run.t_ns + 2 * NS))
    until(run, lambda: False, 5.0)
    assert state_of(run) is SupervisorState.ESTOP
    for _ in range(4):
        run.core.loop._requests_pending |= Request.RESET
        until(run, lambda: False, 0.5)
    assert state_of(run) in (SupervisorState.DISARMED, SupervisorState.READY)


def pose(k, t_ns):
    x, place, level = 0.01 * k, (0.01 * k, 0, 0.1), (1.0, 0, 0, 0)
    sent = Pose(
        "car", k, None, None, t_ns, place, level, t_valid_ns=t_ns, x=x, y=0.0, yaw=0.0,
        height=0.1, tilt=0.0,
    )  # fmt: skip
    return make_mocap(sent, 0)


def test_a_reply_read_before_an_older_pose_is_fused_all_the_same(plan):
    core = make_core(plan, 1, 0, (), leased=True)
    seen = core.loop.perception
    for k in range(100):
        core.loop.perception.on_pose(pose(k, k * 10 * MS))
        seen.estimate(k * 10 * MS + 1)
    now = 1010 * MS
    told = changed(NO_TELEMETRY, t_sent_ns=now - MS, t_received_ns=now, erpm=4614)
    core.loop.perception.on_telemetry(told)
    core.loop.perception.on_pose(pose(100, now - 4 * MS))
    health = seen.estimate(now).health
    assert health.untimely == 0
    assert health.wheel_speed.seen == 1


def test_a_car_is_not_driven_more_slowly_than_its_guardian_waits():
    options = RunOptions(car_file="", path="line", speed=1.0, port="/dev/x", rate_hz=40.0)
    with pytest.raises(SteerdError, match="50 to 1000 Hz"):
        make_plan(options)
    assert make_plan(RunOptions(car_file="", path="line", speed=1.0, simulated=True, rate_hz=40.0))
