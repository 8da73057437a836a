"""Excitation plans: drives from whose sessions the car's parameters are identifiable.

A plan is a list of segments; each gives a speed and a steering angle as functions of time alone.
Open loop it drives the car by itself, in orbits that fit the box; closed loop it is a probing
signal added to the lane keeper's command. Pure.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import atan, cos, floor, inf, isfinite, pi, sin, sqrt, tan
from typing import NamedTuple

from steerd.car_model.params import GRAVITY, Car, wheelbase
from steerd.car_model.path.path_spec import FIGURE_EIGHT_EXTENT
from steerd.car_model.state import ORIGIN, Command, State
from steerd.controller.limits import Limits
from steerd.daemon.settings.thresholds import LAUNCH_DISTANCE, LAUNCH_SPEED

PAPER_SECONDS, PAPER_SPEED, PAPER_RUNS = 8.0, 1.0, 8
"""The paper's circles: 8 to each side, 8 s each, 1 m/s, steering at its limit [s, m/s, -]."""
PAUSE = 1.5  # standstill between the paper's runs [s]
SWING, SWING_LEAST = 0.7, 0.3
"""Amplitude of the steering as a share of the orbit's mean angle; the least on tight orbits."""
SPEED_LOW = 1.0  # lowest speed of a plan [m/s]: below it, tyre parameters are not excited
PROBE = 0.05  # amplitude of the probing signal in closed loop [rad]
PROBE_RADIUS, CIRCLE_RADIUS = 1.8, 1.5
"""Smallest radii of figure eight and circle that leave room for the probing signal [m]."""
_STEP = 0.02  # time step of the forecast [s]
_STEER_GAIN_SPREAD = 0.03  # uncertainty of the steering gain in the forecast
_ACCEL_SHARE = 0.5  # share of the largest acceleration with which the forecast's car gains speed
_MARGIN, _DELAY, _BRAKE = 0.6, 0.1, 3.5
"""Stopping distance in the forecast: [m], [s] and [m/s^2], as the fence's watchdog warns."""
_SHRINK = 0.92  # factor between the radii that are tried
_GRIP_SHARE = 0.95  # share of the largest lateral acceleration that an orbit uses
_RADIUS_MARGIN = 1.05  # factor on the first radius that is tried
_CHIRP_LOW_HZ = 0.3  # first frequency of a chirp [Hz]; patterns up to 1 Hz keep one frequency


class Segment(NamedTuple):
    """One stretch of a plan."""

    seconds: float  # duration [s]
    speed: float  # target speed [m/s]
    steer: float  # mean angle [rad]
    swing: float = 0.0  # amplitude about it [rad]
    f0: float = 0.0  # frequency at the beginning [Hz]
    f1: float = 0.0  # frequency at the end, linear in between [Hz]
    square: bool = False  # steps instead of a sine

    def command(self, t: float) -> Command[float]:
        """The command `t` seconds after the segment's beginning."""
        turns = t * (self.f0 + 0.5 * (self.f1 - self.f0) * t / self.seconds)
        wave = sin(2.0 * pi * turns)
        if self.square:
            wave = 1.0 if turns - floor(turns) < 0.5 else -1.0
        return Command(self.steer + self.swing * wave, self.speed)


@dataclass(frozen=True)
class Box:
    """Rectangle that the car must not leave [m], world frame."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float

    @property
    def fence(self) -> tuple[tuple[float, float], ...]:
        """Its corners, anticlockwise."""
        left, low, right, high = self.x_min, self.y_min, self.x_max, self.y_max
        return (left, low), (right, low), (right, high), (left, high)


@dataclass(frozen=True)
class Drill:
    """A plan to be driven."""

    name: str  # of the plan
    segments: tuple[Segment, ...]  # in order
    closed: bool  # added to the lane keeper's command, instead of replacing it
    box: Box | None  # None without one

    @property
    def seconds(self) -> float:
        """Length of the plan [s]."""
        return sum(s.seconds for s in self.segments)

    def command_at(self, t: float) -> Command[float]:
        """The plan's own command `t` seconds into it; a zero command after its end."""
        for segment in self.segments:
            if t < segment.seconds:
                return segment.command(t)
            t -= segment.seconds
        return Command(0.0, 0.0)

    def wish(self, t: float, lane: Command[float]) -> Command[float]:
        """The command at time `t`, given the lane keeper's command."""
        own = self.command_at(t)
        if not self.closed:
            return own
        return Command(lane.steer + own.steer, lane.speed * own.speed)


def parse_box(text: str) -> Box:
    """A box from `SIDE` (a square about the origin) or `X_MIN,Y_MIN,X_MAX,Y_MAX`.

    Raises:
        ValueError: it is neither.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == 1 and numbers[0] > 0.0 and isfinite(numbers[0]):
        half = 0.5 * numbers[0]
        return Box(-half, -half, half, half)
    if len(numbers) == 4 and numbers[0] < numbers[2] and numbers[1] < numbers[3]:
        return Box(*numbers)
    raise ValueError(f"box {text!r}: give its side, or x_min,y_min,x_max,y_max in metres")


def _make_circles(car: Car[float], limits: Limits) -> Iterator[Segment]:
    left = min(limits.steer_left_max, car.steer_max)
    right = min(limits.steer_right_max, -car.steer_min)
    for steer in (left, -right):
        for _ in range(PAPER_RUNS):
            yield Segment(PAPER_SECONDS, PAPER_SPEED, steer)
            yield Segment(PAUSE, 0.0, steer)


_Pattern = tuple[tuple[float, float, float, bool], ...]
"""(seconds, share of the highest speed, highest frequency [Hz], steps instead of waves)."""


class _Orbit(NamedTuple):
    """Mean and swing of the steering [rad], lowest and highest speed [m/s] on an orbit."""

    steer: float
    swing: float
    slowest: float
    fastest: float


_PROBING = _Orbit(0.0, PROBE, 0.0, 1.0)  # added to the lane keeper's command: shares of its speed


def _make_orbit(
    car: Car[float], limits: Limits, radius: float, speed: float, share: float
) -> _Orbit:
    length = wheelbase(car)
    bound = min(limits.steer_left_max, limits.steer_right_max, car.steer_max, -car.steer_min)
    steer = min(atan(length / radius), bound / (1.0 + min(SWING_LEAST, share)))
    swing = min(share * steer, bound - steer)
    sharpest = tan(steer + swing) / length
    fastest = sqrt(_GRIP_SHARE * limits.lateral_accel_max / sharpest)
    fastest = min(speed, limits.speed_max, fastest)
    return _Orbit(steer, swing, min(SPEED_LOW, fastest), fastest)


def _make_waves(orbit: _Orbit, side: float, pattern: _Pattern) -> Iterator[Segment]:
    for seconds, share, top, square in pattern:
        speed = max(share * orbit.fastest, orbit.slowest)
        low = _CHIRP_LOW_HZ if top > 1.0 else top
        steer, swing = side * orbit.steer, orbit.swing if top else 0.0
        yield Segment(seconds, speed, steer, swing, low, top, square)


_PATTERNS: Mapping[str, _Pattern] = {
    "slalom": ((10.0, 1.0, 1.0, False), (10.0, 0.6, 1.0, False), (10.0, 0.8, 0.7, False)),
    "chirp": ((10.0, 1.0, 4.0, False), (10.0, 0.6, 4.0, False), (10.0, 0.8, 4.0, False)),
    "steps": ((10.0, 1.0, 0.5, True), (10.0, 0.6, 0.5, True), (10.0, 0.8, 0.5, True)),
    "ramp": tuple((3.0, share, 0.0, False) for share in (0.4, 0.55, 0.7, 0.85, 1.0)),
    "speeds": tuple((3.0, share, 0.0, False) for share in (0.4, 1.0, 0.4, 1.0, 0.7, 1.0)),
    "mixed": (
        (3.0, 0.5, 0.0, False), (3.0, 0.75, 0.0, False), (3.0, 1.0, 0.0, False),
        (7.0, 1.0, 0.5, True), (3.0, 0.6, 0.7, True), (8.0, 0.8, 4.0, False),
        (3.0, 1.0, 1.0, False),
    ),
}  # fmt: skip
NAMES: tuple[str, ...] = ("circles", *_PATTERNS)


def _swing_share(name: str) -> float:
    """Room that a plan's steering needs about an orbit's mean angle, as a share of that."""
    return SWING if name == "circles" or any(top for _, _, top, _ in _PATTERNS[name]) else 0.0


def _make_segments(
    name: str, car: Car[float], limits: Limits, radius: float, speed: float
) -> tuple[Segment, ...]:
    if name == "circles":
        return tuple(_make_circles(car, limits))
    orbit = _make_orbit(car, limits, radius, speed, _swing_share(name))
    sides = (tuple(_make_waves(orbit, side, _PATTERNS[name])) for side in (1.0, -1.0))
    return tuple(segment for side in sides for segment in _scale_to_whole_turns(car, side))


def _forecast(
    car: Car[float], segments: Iterable[Segment], gain: float = 1.0
) -> Iterator[State[float]]:
    """States of the car by steady turning, with understeer, launch and the speed's ramp."""
    g, distance = ORIGIN, 0.0
    bend = (1.0 / car.c_sf - 1.0 / car.c_sr) / (car.mu * GRAVITY)
    for segment in segments:
        for k in range(round(segment.seconds / _STEP)):
            wish = segment.command(k * _STEP)
            launched = distance > LAUNCH_DISTANCE
            aim = car.speed_gain * wish.speed if launched else min(wish.speed, LAUNCH_SPEED)
            change = max(-car.decel_max, min((aim - g.speed) / _STEP, _ACCEL_SHARE * car.accel_max))
            speed = g.speed + change * _STEP
            wheel = car.steer_gain * wish.steer + car.steer_bias
            turn = gain * speed * tan(wheel) / (wheelbase(car) + bend * speed * speed)
            yaw, way = g.yaw + turn * _STEP, speed * _STEP
            distance += way
            g = g._replace(x=g.x + way * cos(yaw), y=g.y + way * sin(yaw), yaw=yaw, speed=speed)
            yield g


def forecast_reach(car: Car[float], segments: Sequence[Segment]) -> tuple[float, float]:
    """How far a plan leads along x and y [m], to either side: 3 % in gain, and a stop, included."""
    places = [(0.0, 0.0)]
    for gain in (1.0 - _STEER_GAIN_SPREAD, 1.0, 1.0 + _STEER_GAIN_SPREAD):
        for g in _forecast(car, segments, gain):
            ahead = _MARGIN + g.speed * (_DELAY + g.speed / (2.0 * _BRAKE))
            places += ((g.x, g.y), (g.x + ahead * cos(g.yaw), g.y + ahead * sin(g.yaw)))
    return max(abs(x) for x, _ in places), max(abs(y) for _, y in places)


def _scale_to_whole_turns(car: Car[float], segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """The segments, scaled in time so that they end after whole turns."""
    *_, last = _forecast(car, segments)
    turns = max(1.0, round(abs(last.yaw) / (2.0 * pi)))
    factor = 2.0 * pi * turns / max(abs(last.yaw), 1e-6)
    return tuple(s._replace(seconds=s.seconds * factor) for s in segments)


def make_open_drill(
    name: str, car: Car[float], limits: Limits, box: Box | None, speed: float
) -> Drill:
    """The plan with the widest orbits that fit the box; without one, for the full `speed` [m/s].

    Raises:
        ValueError: no orbit fits.
    """
    radius = _RADIUS_MARGIN * speed**2 * (1.0 + _swing_share(name)) / limits.lateral_accel_max
    smallest = wheelbase(car) / tan(min(limits.steer_left_max, limits.steer_right_max))
    while True:
        segments = _make_segments(name, car, limits, max(radius, smallest), speed)
        if box is None:
            return Drill(name, segments, False, None)
        far_x, far_y = forecast_reach(car, segments)  # from the middle of the box, along x
        if 2.0 * far_x <= box.x_max - box.x_min and 2.0 * far_y <= box.y_max - box.y_min:
            return Drill(name, segments, False, box)
        if radius < smallest or name == "circles":
            break
        radius *= _SHRINK
    side = 2.0 * max(far_x, far_y)
    text = f"plan {name} needs a box of {side:.1f} m, the car starting in its middle"
    raise ValueError(text if name == "circles" else f"{text}; or drive it with --closed")


def make_closed_path(box: Box | None) -> str:
    """The lane keeper's path under a probe: a figure eight if the box has room, else a circle.

    Raises:
        ValueError: the box is too small for either.
    """
    if box is None:
        return f"figure8:radius={PROBE_RADIUS}"
    half = 0.5 * min(box.x_max - box.x_min, box.y_max - box.y_min) - _MARGIN
    if 2.0 * half / FIGURE_EIGHT_EXTENT >= PROBE_RADIUS:
        return f"figure8:size={2.0 * half:g}"
    if half / 2.0 >= CIRCLE_RADIUS:
        return f"circle:radius={half / 2.0:g}"
    side = 2.0 * (2.0 * CIRCLE_RADIUS + _MARGIN)
    raise ValueError(f"a probe on top of the lane keeper needs a box of {side:.1f} m")


def parse_drill(spec: str, car: Car[float], limits: Limits) -> Drill:
    """A drill from text such as `mixed;open;speed=2.5;box=8`.

    Closed loop it is a probe: its steering is added to the lane keeper's, speeds are shares of its.

    Raises:
        ValueError: it makes no sense.
    """
    name, *rest = spec.split(";")
    if name not in NAMES:
        raise ValueError(f"plan {name!r}: one of {', '.join(NAMES)}")
    values = dict(part.partition("=")[::2] for part in rest)
    box = parse_box(values["box"]) if "box" in values else None
    if "closed" in values:
        if name == "circles":
            raise ValueError("circles are driven open loop: steering at its limit leaves no room")
        return Drill(name, tuple(_make_waves(_PROBING, 1.0, _PATTERNS[name] * 2)), True, box)
    speed = float(values.get("speed", inf))
    return make_open_drill(name, car, limits, box, min(speed, limits.speed_max))
