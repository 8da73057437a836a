"""Which design steers: that of the car file, or one for the car as learnt. Pure.

A design is taken between ticks, after its check, and comes into force in the next tick. The file's
comes back by itself: when the learner is silent, the drive ends, the estimate is lost, feedback is
tuned by hand, or the car is far off its lane. A change of designs moves no wheel: the difference
of the two orders fades. Limits, watchdogs and the gate know nothing of this; lane errors stay those
of the poses as they come.

The check of a design takes tens of milliseconds, so one piece of it runs after each tick's bytes
were written. Whatever comes meanwhile is left alone; the learner proposes anew each second.
"""

# Why: docs/decisions/filter-and-controller.md#d85

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import cos, exp, inf, nan, sin

from steerd.car_model.path.path import project
from steerd.car_model.state import Command, State
from steerd.controller import lane_controller as lanes
from steerd.controller.acceptance import Acceptance, check_design
from steerd.controller.gain_table import N_LANE, N_TURNING, GainTable
from steerd.controller.lane_keeper import lane_errors
from steerd.controller.learnt import (
    Design,
    Learnt,
    Servo,
    follow_learnt,
    learnt_of,
    order_servo,
    step_servo,
)
from steerd.controller.live import AS_DESIGNED, LiveValues, shift_lane
from steerd.steer_bus import messages as m
from steerd.steer_bus.codec import CodecError, decode

SILENT_NS = 4_000_000_000  # a learner that proposes nothing for so long is not followed any more
FADING_S = 0.7  # time in which the difference of two designs' orders fades to 1/e [s]
FAR_SHARE = 0.5
"""Share of the lateral error that stops the car (W17) at which the file's design comes back."""
LEARNING, DRIVE_ENDED, SILENT, TUNED, FAR, LOST = (
    "the learner has proposed nothing yet", "no drive", "the learner is silent",
    "the feedback is tuned by hand", "far off the lane", "no estimate",
)  # fmt: skip


@dataclass(frozen=True)
class Adapting:
    """Which design steers."""

    held: Acceptance | None  # what designs are held against; None where none is followed
    file: lanes.LaneController  # the car file's controller
    controller: lanes.LaneController  # the one in force
    design: Design | None = None  # that it follows, None for the file's, with its number, else 0
    number: int = 0
    why: str = LEARNING  # why the file's is in force
    # The design that was taken last, with its number; None for the file's
    coming: tuple[int, Design] | None = None
    heard_ns: int = 0  # when a proposal was taken or renewed last
    # Lateral error at which the file's design comes back [m]; `far` whether it was there
    far_e1: float = inf
    far: bool = False
    given_up: bool = False  # the car was far off its lane under a learnt design in this drive
    offset: float = 0.0  # order still to fade [rad]; `t_ns` of the last tick
    t_ns: int = 0
    servo: Servo = field(default_factory=Servo)  # where the wheels of the learnt car are

    @property
    def follows(self) -> bool:
        """Whether a learnt design is in force."""
        return self.design is not None

    @property
    def car(self) -> Learnt:
        """The numbers of the design in force."""
        return learnt_of(self.file.car) if self.design is None else self.design.car


def make_adapting(
    file: lanes.LaneController, held: Acceptance | None = None, lateral: float = inf
) -> Adapting:
    """At the start: the file's design; `lateral` is the lateral error that stops the car [m]."""
    return Adapting(held, file, file, far_e1=FAR_SHARE * lateral)


def take_design(now: Adapting, number: int, design: Design | None, why: str, t_ns: int) -> Adapting:
    """A design that passed its check, for the next tick; None, with a reason, for the file's."""
    if now.held is None:
        return now
    coming = None if design is None else (number, design)
    return replace(now, coming=coming, heard_ns=t_ns, why=why if design is None else now.why)


def step_adapting(now: Adapting, t_ns: int, *, driving: bool, tuned: bool) -> Adapting:
    """The design of this tick.

    `driving`: a drive goes on, without a fault; `tuned`: the feedback's share is not as designed.
    """
    given_up = driving and (now.given_up or (now.far and now.follows))
    doubts = (
        (not driving, DRIVE_ENDED),
        (given_up, FAR),
        (tuned, TUNED),
        (now.coming is not None and t_ns - now.heard_ns > SILENT_NS, SILENT),
    )
    why = next((text for holds, text in doubts if holds), "")
    now = replace(now, given_up=given_up)
    if why or now.coming is None:
        return to_file(now, why or now.why)
    number, design = now.coming
    if number == now.number:
        return now
    controller = follow_learnt(now.file, design)
    return replace(now, controller=controller, design=design, number=number, why="")


def to_file(now: Adapting, why: str) -> Adapting:
    """Back to the car file's design."""
    return replace(now, controller=now.file, design=None, number=0, why=why, coming=None)


def lose_estimate(now: Adapting) -> Adapting:
    """Without an estimate there is nothing to fade."""
    return replace(to_file(now, LOST), offset=0.0) if now.held else now


def remember_order(now: Adapting, t_ns: int, order: Command[float] | None) -> Adapting:
    """What left for the servo."""
    if now.held is None:
        return now
    return replace(now, servo=order_servo(now.servo, t_ns, order))


def see_as_learnt(now: Adapting, state: State[float]) -> State[float]:
    """The estimate as the controller in force is to see it: its servo, its mocap body."""
    if now.design is None:
        return state
    car = now.design.car
    yaw = state.yaw - car.body_yaw
    c, s = cos(yaw), sin(yaw)
    return state._replace(
        x=state.x - (c * car.body_forward - s * car.body_left),
        y=state.y - (s * car.body_forward + c * car.body_left),
        yaw=yaw,
        slip_angle=state.slip_angle + car.body_yaw,
        steer=now.servo.wheel,
    )


def steer(
    before: Adapting,
    memory: lanes.ControllerState,
    estimate: State[float],
    t_ns: int,
    *,
    issued: Command[float] | None,
    driving: bool,
    stop: bool,
    live: LiveValues = AS_DESIGNED,
) -> tuple[Command[float], lanes.ControlReport, lanes.ControllerState, Adapting]:
    """One tick of the design in force; where it is another than before, no wheel moves for that.

    `before` and the controller's `memory` are the last tick's, `issued` is the last order.
    `driving`: a drive goes on, without a fault; `stop`: the car is to come to rest.
    """
    if before.held is None:
        command, report, memory = lanes.control(
            before.controller, memory, estimate, t_ns, issued=issued, stop=stop, live=live
        )
        return command, report, memory, before
    tuned = live.gain != AS_DESIGNED.gain
    now = _step_servo(step_adapting(before, t_ns, driving=driving, tuned=tuned), t_ns)
    offset = now.offset * exp(-max(t_ns - now.t_ns, 0) * 1e-9 / FADING_S)
    old = None
    if now.controller is not before.controller:
        seen = see_as_learnt(replace(before, servo=_step_servo(before, t_ns).servo), estimate)
        old, _, _ = lanes.control(
            before.controller, memory, seen, t_ns, issued=issued, stop=stop, live=live
        )
        memory = hand_over(memory, now.controller.table.pasts)
    hint = memory.hint
    command, report, memory = lanes.control(
        now.controller, memory, see_as_learnt(now, estimate), t_ns,
        issued=issued, stop=stop, live=live,
    )  # fmt: skip
    if old is not None:
        offset = old.steer + offset - command.steer
    if now.follows:  # watchdogs judge the lane errors of the estimate as it is
        at = project(now.controller.keeper.path, estimate.x, estimate.y, hint)
        report = report._replace(**lane_errors(estimate, shift_lane(at, live.offset))._asdict())
    command = command._replace(steer=command.steer + offset)
    far = abs(report.e1) > now.far_e1
    return command, report, memory, replace(now, offset=offset, far=far, t_ns=t_ns)


def hand_over(memory: lanes.ControllerState, pasts: int) -> lanes.ControllerState:
    """The controller's memory for a design with another number of past references."""
    known = memory.past[:pasts]
    oldest = known[-1] if known else 0.0
    return memory._replace(past=known + (oldest,) * (pasts - len(known)))


def _step_servo(now: Adapting, t_ns: int) -> Adapting:
    delay_s = now.controller.report.timing.delay_s
    return replace(now, servo=step_servo(now.servo, now.controller.car, delay_s, t_ns))


COLUMNS_MAX, ROWS_MAX = 120, 400  # more past references and design speeds than any loop has
DESIGN_BYTES = 90_000  # longest message that is read, of the learner
_NOTHING = Learnt(*(nan,) * len(Learnt._fields))


def make_design(mono_ns: int, epoch_ns: int, number: int, design: Design) -> m.Design:
    """A design with its number, at a monotonic time."""
    rows = design.table.rows
    flat = [gain for row in rows for gain in row]
    return m.Design(
        m.make_header(mono_ns + epoch_ns, m.BODY), mono_ns, number, len(rows[0]), *design.car,
        design.table.speed_min, design.table.spacing, "", struct.pack(f"<{len(flat)}d", *flat),
    )  # fmt: skip


def make_no_design(mono_ns: int, epoch_ns: int, why: str) -> m.Design:
    """The car file's own design, and why."""
    header = m.make_header(mono_ns + epoch_ns, m.BODY)
    return m.Design(header, mono_ns, 0, 0, *_NOTHING, nan, nan, why, b"")


def read_design(message: m.Design) -> Design | None:
    """The design of a message; None for the car file's own, which has number 0.

    Raises:
        ValueError: its gains are no table.
    """
    if message.number == 0:
        return None
    columns, size = message.columns, len(message.gains)
    whole = N_LANE + N_TURNING <= columns <= COLUMNS_MAX and size and size % (8 * columns) == 0
    if not whole or size > 8 * columns * ROWS_MAX:
        raise ValueError(f"{size} bytes are no rows of {columns} gains")
    flat = struct.unpack(f"<{size // 8}d", message.gains)
    rows = tuple(flat[i : i + columns] for i in range(0, len(flat), columns))
    car = Learnt(*(getattr(message, name) for name in Learnt._fields))
    return Design(car, GainTable(message.speed_min, message.spacing, rows))


OLD_NS = 3_000_000_000
"""A proposal about a pose this much older, or younger, than now is left alone."""
REFUSED = "refused: "  # what a text begins with that says why a proposal was not taken


class DesignDesk:
    """Proposals in, messages to be taken out; knows no clock."""

    def __init__(self) -> None:
        self.taken: Design | None = None  # last
        self.refused = 0  # so many
        self._number = 0
        # A design, the numbers in force that it is held against, and what is left of its check
        self._checking: tuple[Design, Learnt, Iterator[str]] | None = None
        self._answer: str | None = None
        self._renew = False
        self._followed = False

    def offer(self, now: Adapting, data: bytes, t_ns: int) -> None:
        """A proposal arrived; what is no message or out of time is left alone."""
        if now.held is None or self._checking is not None or len(data) > DESIGN_BYTES:
            return
        try:
            message = decode(m.Design, data)
            if abs(t_ns - message.mono_ns) > OLD_NS:
                return
            design = read_design(message)
        except CodecError:
            return
        except ValueError as error:
            self._refuse(str(error))
            return
        if design is None:
            self._answer = message.text
        elif now.follows and design == self.taken:
            self._renew = True
        else:
            self._checking = design, now.car, check_design(now.held, now.car, design)

    def _refuse(self, why: str) -> None:
        self.refused += 1
        self._answer = REFUSED + why

    def step(self, now: Adapting, t_ns: int, epoch_ns: int) -> m.Design | None:
        """One piece of the check; what the loop is to take, if there is something."""
        fell, self._followed = self._followed and not now.follows, now.follows
        if fell:
            self._checking = self.taken = None
            return make_no_design(t_ns, epoch_ns, now.why)
        if self._checking is not None:
            self._check(now, *self._checking)
        if self._answer is not None:
            why, self._answer, self.taken = self._answer, None, None
            return make_no_design(t_ns, epoch_ns, why)
        if self._renew and self.taken is not None:
            self._renew = False
            return make_design(t_ns, epoch_ns, self._number, self.taken)
        return None

    def _check(self, now: Adapting, design: Design, against: Learnt, pieces: Iterator[str]) -> None:
        try:
            problem = next(pieces, None)
        except (ValueError, ArithmeticError) as error:  # numbers that no loop has
            problem = f"it cannot be computed: {error}"
        if problem == "":  # this piece is good, more come
            return
        self._checking = None
        if problem:
            self._refuse(problem)
        elif now.car == against:  # else another is in force than it was held against
            self.taken, self._renew = design, True
            self._number += 1
