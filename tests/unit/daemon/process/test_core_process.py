"""The control core's process: exceptions that have no caller stop the car."""

import gc
import sys
import threading

import pytest

from steerd.daemon.assembly.build import make_core, make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.loop.flags import Flag
from steerd.daemon.process.core_process import latch_stray_exceptions, make_mocap, status_sink
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import topics


class Broken:
    """Raises when it is collected."""

    def __del__(self):
        raise LookupError("nobody catches this")


@pytest.mark.parametrize("where", ["thread", "destructor"])
def test_w29_an_exception_without_a_caller_stops_the_car_for_good(monkeypatch, where):
    core = make_core(make_plan(RunOptions(car_file="", path="line")), 1, 0, (), leased=True)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    latch_stray_exceptions(core)
    if where == "thread":
        thread = threading.Thread(target=lambda: [][1])
        thread.start()
        thread.join()
    else:
        Broken()
        gc.collect()
    assert isinstance(core.error, LookupError)
    assert core.flags == Flag.EXCEPTION


def test_the_terminal_gets_changes_at_once_and_the_rest_ten_times_a_second():
    written = []

    class Pipe:
        def write(self, packed, t_ns):
            written.append((t_ns, len(packed)))

    sink = status_sink(Pipe())
    records = [
        PipeRecord(topic, 0, 0, 0, b"") for topic in (topics.STATE, topics.TRANSITION, topics.IMU)
    ]
    for t_ns in (0, 50_000_000, 100_000_000):
        sink(records, t_ns)
    assert written == [(0, 2), (50_000_000, 1), (100_000_000, 2)]


@pytest.mark.parametrize("address", ["", "nonsense://x", "natnet://"])
def test_an_invalid_mocap_address_is_refused(address):
    plan = make_plan(RunOptions(car_file="", path="line", mocap=address))
    with pytest.raises(SteerdError):
        make_mocap(plan)
