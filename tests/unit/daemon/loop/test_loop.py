"""A run with several starts: each drive passes its own launch checks."""

from steerd.daemon.assembly.build import make_plan
from steerd.daemon.loop.findings import WATCHDOGS
from steerd.daemon.loop.supervisor import LAUNCH_SPEED
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.offline.virtual import make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus.messages import BODY, OperatorRequest, RequestKind, make_header


def until(run, done, limit_s=20.0):
    end = run.t_ns + round(limit_s * 1e9)
    while not done():
        assert run.t_ns < end, run.core.loop.supervisor
        run.step()


def ask(run, kind):
    loop = run.core.loop
    header, lease = make_header(0, BODY), loop.lease
    asked = OperatorRequest(header, lease.boot_id, 5, lease.seq + 1, int(kind), "desk")
    loop.on_operator(asked, run.t_ns)


def test_a_second_start_is_as_slow_as_the_first():
    options = RunOptions(car_file="", path="line", speed=1.0, simulated=True, duration_s=60.0)
    run = make_virtual_run(make_plan(options))
    loop = run.core.loop

    def reach(state):
        until(run, lambda: loop.supervisor.state is state)

    reach(SupervisorState.READY)
    ask(run, RequestKind.ARM)
    reach(SupervisorState.ARMED)
    for _ in range(2):
        ask(run, RequestKind.START)
        reach(SupervisorState.RUNNING)
        assert run.core.last.supervisor.cap == LAUNCH_SPEED
        assert not run.core.last.facts & Fact.LAUNCHED
        until(run, lambda: run.core.last.facts & Fact.LAUNCHED)
        ask(run, RequestKind.STOP)
        reach(SupervisorState.ARMED)
        run.step()
        assert not run.core.last.facts & Fact.LAUNCHED


def test_nobody_is_advised_about_an_estimate_that_is_not_there_yet():
    options = RunOptions(car_file="", path="line", speed=1.0, simulated=True, duration_s=1.0)
    run = make_virtual_run(make_plan(options))
    run.step()
    (about,) = [finding for finding in run.core.last.findings if finding.id == "W6"]
    assert about.text.endswith(": no estimate yet")
    assert about.severity is WATCHDOGS["W6"].severity, "it trips all the same"
