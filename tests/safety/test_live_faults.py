"""Faults in real time: real processes, signals, sockets and a pty, judged on the pty's byte log.

Other programs share the machine, so what is asserted is the order of the bytes, and bounds that are
ten times looser than those promised; ``benchmarks/stop_latency.py`` has the figures. Those that say
how the run ends and a seeded tenth of the others run by default, all of them with
``STEERD_LIVE=all`` (`make safety`). `STEERD_LIVE_LOG` names a file to which each cell is appended,
for `python -m tests.safety.report --live`.
"""

import json
import os
import select
import signal
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from steerd.daemon.common.errors import ExitCode
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus.messages import RequestKind
from tests.safety.live import start_live
from tests.safety.live_faults import CELLS, FAULTS, run_live, send
from tests.safety.live_hands import at_terminal

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]


def chosen() -> list[tuple[str, str]]:
    """All cells, or those whose fault says how the run ends and a seeded tenth of the others."""
    if os.environ.get("STEERD_LIVE") == "all":
        return CELLS
    ended = [cell for cell in CELLS if cell[1] == "P5" and FAULTS[cell[0]].code is not None]
    rest = [cell for cell in CELLS if cell not in ended]
    rng = np.random.default_rng(int(os.environ.get("STEERD_LIVE", "0")))
    return [*ended, *(rest[k] for k in sorted(rng.choice(len(rest), len(rest) // 10, False)))]


@pytest.mark.parametrize(("name", "phase"), chosen())
def test_live_cell(name, phase) -> None:
    outcome = run_live(name, phase)
    if not outcome.wrong and (log := os.environ.get("STEERD_LIVE_LOG")):
        with Path(log).open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(outcome)) + "\n")
    assert not outcome.wrong, outcome


def test_a_run_that_a_person_ended_is_no_safety_stop(tmp_path) -> None:
    with start_live(tmp_path) as live:
        live.reach("P7")
        live.until(lambda: live.state is SupervisorState.ARMED)
        assert live.end() == ExitCode.OK


@pytest.mark.parametrize("last", ["first signal", "second signal", "parent"])
def test_an_emergency_stop_without_a_vesc_ends_all_the_same(tmp_path, last) -> None:
    with start_live(tmp_path) as live:
        live.reach("P5")
        live.ask(RequestKind.ESTOP)
        live.until(lambda: live.state is SupervisorState.ESTOP)
        live.device.kill()
        core = live.processes.core.process
        if last == "parent":
            live.processes.requests.close()
        if last.endswith("signal"):
            send("core", signal.SIGTERM, 2 if last == "second signal" else 1)(live)
        end = os.pidfd_open(core.pid)
        assert select.select([end], [], [], 8.0)[0], "the core lives on"
        os.close(end)
        for child in (live.processes.children[name] for name in ("gateway", "recorder")):
            child.process.wait(5.0)


@pytest.mark.parametrize("frozen", ["core", "recorder", "gateway", "guardian"])
def test_what_is_frozen_ends_with_a_killed_parent(tmp_path, frozen) -> None:
    with at_terminal(tmp_path) as live:
        live.reach("P5")
        send(frozen, signal.SIGSTOP)(live)
