"""Live parameters of a run: which requests are accepted, and what is in force. Pure.

They change the lane keeper's wish and nothing after it: limits, gate and watchdogs do not know them
(but for the lateral error, which is judged against both lanes).
"""

# Why: docs/decisions/safety.md#d74

from collections.abc import Iterator
from math import isnan

from steerd.controller.lane_controller import ControlReport
from steerd.controller.live import AS_DESIGNED, LiveBounds, LiveValues, approach
from steerd.steer_bus.messages import BODY, ParameterRequest, Parameters, make_header
from steerd.steer_bus.quick_values import changed, quick_value

STEP_MAX_S = 0.1  # longest time that one tick's approach is granted for [s]: a pause is no leap
_WHY = {
    "speed": (" m/s", "the run was started and checked for that"),
    "offset": (" m", "further off, or tighter than the car turns, it would leave its lane"),
    "gain": ("", "the closed loop was checked for that"),
}
"""Unit of a live parameter, and why it has bounds."""


@quick_value
class Live:
    """Live parameters of a run."""

    bounds: LiveBounds | None  # None where the lane keeper does not drive alone
    aim: LiveValues  # what was accepted last
    now: LiveValues  # what is in force, on its way there
    t_ns: int = 0  # of the last tick
    lease_id: int = 0  # of the last request, 0 before the first; so is `seq`
    seq: int = 0
    accepted: bool = False  # whether it was
    text: str = ""  # the answer to it


def make_live(bounds: LiveBounds | None) -> Live:
    """Before the first request."""
    start = bounds.start if bounds else AS_DESIGNED
    return Live(bounds, start, start)


def take_request(live: Live, request: ParameterRequest, admitted: bool) -> Live:
    """Accept all values of a request or none; `admitted`: its sender holds the lease."""
    wanted = request.speed, request.offset, request.gain
    aim = LiveValues(*(
        old if isnan(new) else new for new, old in zip(wanted, live.aim, strict=True)
    ))  # fmt: skip
    problem = next(_find_problems(live.bounds, aim, admitted), "")
    text = problem or f"set by {request.operator or 'an operator'}"
    return changed(
        live, aim=live.aim if problem else aim, lease_id=request.lease_id, seq=request.seq,
        accepted=not problem, text=text,
    )  # fmt: skip


def _find_problems(bounds: LiveBounds | None, aim: LiveValues, admitted: bool) -> Iterator[str]:
    if bounds is None:
        yield "refused: an external controller or a plan drives, not the lane keeper alone"
        return
    if not admitted:
        yield "refused: somebody else holds this car, or the request is not of this run"
        return
    for name, value in aim._asdict().items():
        low, high = getattr(bounds.low, name), getattr(bounds.high, name)
        if not low <= value <= high:
            unit, why = _WHY[name]
            yield f"refused: {name} {value:g}{unit}, allowed {low:g} to {high:g}{unit}: {why}"


def step_live(live: Live, t_ns: int, parked: bool) -> Live:
    """One tick: a car that may move comes to new values gradually, a parked one at once."""
    dt = min(max((t_ns - live.t_ns) * 1e-9, 0.0), STEP_MAX_S)
    now = live.aim if parked else approach(live.now, live.aim, dt)
    return changed(live, now=now, t_ns=t_ns)


def relax(live: Live, why: str) -> Live:
    """Back to the path and the designed feedback; a speed that was lowered stays low."""
    aim = LiveValues(live.aim.speed, AS_DESIGNED.offset, AS_DESIGNED.gain)
    return live if aim == live.aim else changed(live, aim=aim, text=why)


def judge_both_lanes(report: ControlReport | None, now: LiveValues) -> ControlReport | None:
    """The report with the larger of the errors against path and shifted lane, for watchdogs."""
    if report is None or not now.offset:
        return report
    on_path = report.e1 + now.offset
    return report._replace(e1=on_path) if abs(on_path) > abs(report.e1) else report


def make_parameters(live: Live, stamp_ns: int) -> Parameters | None:
    """The message; None where there are no live parameters and nobody asked for one."""
    if live.bounds is None and not live.seq:
        return None
    b, a = live.bounds or LiveBounds(*(_NOTHING,) * 3), live.aim if live.bounds else _NOTHING
    return Parameters(
        make_header(stamp_ns, BODY), live.lease_id, live.seq, int(live.accepted),
        a.speed, b.low.speed, b.high.speed,
        a.offset, b.low.offset, b.high.offset,
        a.gain, b.low.gain, b.high.gain,
        live.text,
    )  # fmt: skip


_NOTHING = LiveValues(float("nan"), float("nan"), float("nan"))
