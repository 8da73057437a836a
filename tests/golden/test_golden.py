"""Golden sessions: recorded drives whose every order today's loop must give again.

Each holds what reached the loop and what it ordered, no more. A difference is changed behaviour:
fix it, or, if it is meant, run `pytest tests/golden --update-golden`, read the differences that it
prints (`-rP` shows them), and say in the commit message why the car now drives otherwise.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from steerd.daemon.assembly.build import NS, RunPlan, make_plan, make_world_config
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.loop.loop import Flag
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.fast import make_recording
from steerd.daemon.offline.replay import TOLERANCE, describe_difference, replay
from steerd.daemon.offline.virtual import VirtualRun, make_virtual_run
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.world import World
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import open_session

FOLDER, S = Path(__file__).parent, SupervisorState
KEPT = {
    topics.TICK, topics.MOCAP, topics.VESC, topics.IDENTITY, topics.IMU, topics.ACTUATION,
    topics.TRANSITION, topics.DRIVE, topics.OPERATOR,
}  # fmt: skip
"""What reaches the loop, and what it gives."""


def stop_at(t_s: float) -> Callable[[VirtualRun], None]:
    """An emergency stop from somebody, at a time."""
    done = False

    def act(run: VirtualRun) -> None:
        nonlocal done
        if not done and run.t_ns >= t_s * NS:
            done = True
            header = m.make_header(run.t_ns, m.BODY)
            request = m.OperatorRequest(header, 0, 1, 1, int(m.RequestKind.ESTOP), "bystander")
            run.core.on_request(topics.OPERATOR.name, encode(request), run.t_ns)

    return act


class Scene(NamedTuple):
    """A drive, what goes wrong in it, who interferes, and the states that it must visit."""

    options: RunOptions
    faults: tuple[Fault, ...] = ()
    act: Callable[[], Callable[[VirtualRun], None]] = lambda: lambda _run: None
    visits: tuple[SupervisorState, ...] = (S.RUNNING, S.STOPPING, S.DISARMED)
    seconds: float = 30.0


def drive_options(path: str, speed: float, duration_s: float, seed: int) -> RunOptions:
    drive = {"path": path, "speed": speed, "duration_s": duration_s, "seed": seed}
    return RunOptions("", simulated=True, auto_arm=True, **drive)


def between(name: str, begin_s: float, end_s: float) -> Fault:
    return Fault(name, round(begin_s * NS), round(end_s * NS))


_BROKEN = (S.RUNNING, S.FAULT_STOP, S.FAULT_LATCHED)
NOISY = (between("garbage_burst", 2.0, 2.5), between("reply_jitter", 2.5, 2.9),
         between("reply_loss", 2.9, 9.0))  # fmt: skip
SCENES = {
    "straight": Scene(drive_options("line", 1.5, 2.5, 1)),
    "circle": Scene(drive_options("circle:radius=2", 1.0, 2.5, 2)),
    "slalom": Scene(drive_options("figure8:radius=1.3", 1.5, 2.6, 3)),
    "estop": Scene(drive_options("circle:radius=-2", 1.5, 9.0, 4), act=lambda: stop_at(3.0),
                   visits=(S.RUNNING, S.ESTOP), seconds=4.5),
    "mocap_dropout": Scene(drive_options("circle:radius=2", 1.0, 9.0, 5), visits=_BROKEN,
                           faults=(between("silence", 3.0, 9.0),), seconds=4.8),
    "noisy_serial": Scene(drive_options("circle:radius=2", 1.0, 2.0, 6), NOISY),
}  # fmt: skip


def record(scene: Scene, target: Path) -> None:
    """Drive a scene, keeping what a replay needs."""
    plan: RunPlan = make_plan(scene.options)
    target.unlink(missing_ok=True)
    recording = make_recording(plan, target)

    def sink(records: list, t_ns: int) -> None:
        for each in records:
            if each.topic in KEPT:
                topic = topics.make_session_topic(plan.options.car, each.topic)
                recording.writer.write(topic, each.data, each.log_time_ns, each.publish_time_ns)

    run = make_virtual_run(plan, (sink,), World(make_world_config(plan), scene.faults))
    act = scene.act()
    while run.t_ns < scene.seconds * NS and not (run.core.loop.ran and run.core.loop.parked):
        run.step()
        act(run)
    assert run.core.flags & Flag.LINKED
    recording.writer.finish({"reason": "end of the run"})


def replayed(path: Path) -> tuple[int, list[str]]:
    """Ticks that were compared, and what differs."""
    going, differences = replay(open_session(path), path.name)
    lines = [describe_difference(each, 0) for each in differences]
    return going.ticks, lines


@pytest.mark.parametrize("name", SCENES)
def test_every_order_is_the_golden_one(name, request):
    path = FOLDER / f"{name}.mcap"
    if request.config.getoption("--update-golden"):
        try:
            before = replayed(path)[1] if path.exists() else ["no such session yet"]
        except SteerdError as error:
            before = [str(error)]
        print(f"{name}: {len(before)} orders change", *before[:20], sep="\n")
        record(SCENES[name], path)
    ticks, differences = replayed(path)
    assert ticks > 300
    assert TOLERANCE == 1e-9
    assert not differences, "\n".join(differences[:10])
    # It holds the scene that its name promises.
    assert path.stat().st_size < 200_000
    session = open_session(path)
    assert session.info().clean
    changes = [r.decode() for r in session.messages("/steerd/car1/transition")]
    states = [SupervisorState(change.to_state) for change in changes]
    wanted = iter(states)
    assert all(state in wanted for state in SCENES[name].visits), states
    poses = session.columns(m.MocapPose)
    assert (poses["frame"][1:] > poses["frame"][:-1]).all()
    assert poses["x"].size > 200
    modes = session.columns(m.Actuation)["mode"]
    assert (modes == m.ActuationMode.SPEED).sum() > 100


def test_a_loop_that_steers_otherwise_is_noticed(monkeypatch):
    """The golden comparison itself: 1e-4 rad must not pass."""
    import steerd.controller.lane_controller as lanes

    sound = lanes.control

    def biased(*args: object, **more: object) -> object:
        command, report, state = sound(*args, **more)
        return command._replace(steer=command.steer + 1e-4), report, state

    monkeypatch.setattr(lanes, "control", biased)
    _, differences = replayed(FOLDER / "circle.mcap")
    assert len(differences) > 50
