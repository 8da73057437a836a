"""What single effects do to a car, against formulas worked out by hand; effects by name."""

import math

import numpy as np
import pytest

from steerd.car_model.chassis import Axles, Rates, lateral_forces
from steerd.car_model.effect import Contact
from steerd.car_model.effects import ALIASES, EFFECTS, find_effect, parse_effects
from steerd.car_model.model import Model, model_rates, observe
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR, GRAVITY
from steerd.car_model.planar import make_planar
from steerd.car_model.rollout import glide, simulate, start
from steerd.car_model.single_track import loads_at
from steerd.car_model.state import ORIGIN, Command, State
from tests.textbook import feedforward_steer, steady_slip

CAR = DEFAULT_CAR
REST = loads_at(CAR, 0.0)


def steady_turn(speed: float, curvature: float) -> State[float]:
    return ORIGIN._replace(
        speed=speed, yaw_rate=speed * curvature, slip_angle=steady_slip(CAR, speed, curvature),
        steer=feedforward_steer(CAR, speed, curvature),
    )  # fmt: skip


def drive(name, values, first, command, seconds=1.0, h=0.005):
    model = Model(CAR, (EFFECTS[name],), (values,))
    return simulate(FLOAT, model, start(model, first, 0.0), [command] * round(seconds / h), h)


def glided(
    name: str, values: tuple[float, ...], yaw: float = 0.0, accel: float = 0.0, h: float = 0.001
):
    """A moment after 2 m/s, with straight wheels."""
    model = Model(CAR, (EFFECTS[name],), (values,))
    moment = start(model, ORIGIN._replace(speed=2.0, yaw=yaw), 0.0)
    return glide(FLOAT, model, moment, 0.0, accel, 0.0, h).state


def contact(slips: Axles[float], accel: float = 0.0, car=CAR, state=ORIGIN) -> Contact:
    loads = loads_at(car, accel)
    return Contact(car, state, state.steer, accel, slips, loads, lateral_forces(car, slips, loads))


def tyres(name: str, values: tuple[float, ...], slips: Axles[float], accel: float = 0.0, car=CAR):
    return EFFECTS[name].forces(FLOAT, values, contact(slips, accel, car))


def test_backlash_holds_the_wheels_inside_the_gap():
    effect = EFFECTS["steer_backlash"]
    memory: tuple[float, ...] = (0.0,)
    wheels = []
    for angle in (0.0, 0.005, 0.02, 0.05, 0.045, 0.035, 0.0, -0.05):
        wheel, memory = effect.linkage(FLOAT, (0.02,), memory, angle)
        wheels.append(wheel)
    assert wheels == pytest.approx([0.0, 0.0, 0.01, 0.04, 0.04, 0.04, 0.01, -0.04])


def test_relaxation_is_a_first_order_lag_that_leaves_the_steady_turn_alone():
    effect = EFFECTS["tyre_relaxation"]
    length, speed, h, slope = 0.06, 2.0, 0.004, 0.5
    memory: tuple[float, ...] = (0.0, 0.0)
    for k in range(50):
        ends = (Axles(slope * k * h, 0.0), Axles(slope * (k + 1) * h, 0.0))
        memory = effect.remember(FLOAT, (length,), memory, speed, *ends, h)
    tau = length / speed
    lag = -slope * tau * (1.0 - math.exp(-50 * h / tau))
    assert memory == pytest.approx((lag, 0.0), rel=1e-12)
    turn = steady_turn(2.0, 0.6)
    last = drive("tyre_relaxation", (0.08,), turn, Command(turn.steer, 2.0), 3.0)[-1]
    assert last.state.yaw_rate == pytest.approx(1.2, rel=1e-6)
    assert last.memory == pytest.approx((0.0, 0.0), abs=1e-7)


def test_saturation_that_begins_early_is_a_brush_tyre_and_levels_off_at_the_friction_limit():
    """Fiala's tyre (Pacejka, section 3.2) that slides as a whole at 0.6 mu Fz, to 4 %."""
    limit, slides = CAR.mu * REST.front, 0.6
    for z in (0.02, 0.1, 0.3, 0.6, 1.0, 1.5):
        s = z / (3.0 * slides)
        brush = limit * z * (1.0 - s + s * s / 3.0)
        ours = tyres("tyre_saturation", (1.656, 0.496), Axles(z / CAR.c_sf, 0.0)).front
        assert ours == pytest.approx(brush, rel=0.04)
    small = tyres("tyre_saturation", (1.656, 0.496), Axles(1e-4, 0.0)).front
    assert small == pytest.approx(limit * CAR.c_sf * 1e-4, rel=1e-3)
    for q in (1.0, 4.0):
        large = tyres("tyre_saturation", (q, 0.0), Axles(100.0, 0.0)).front
        assert large == pytest.approx(limit / math.sqrt(q), rel=1e-3)


@pytest.mark.parametrize(("speed", "yaw_rate", "slip_angle", "wheel", "accel"), [
    (2.0, 1.5, -0.03, 0.2, 0.0), (1.5, 1.2, 0.02, 0.3, -1.0), (3.0, -1.0, 0.05, -0.15, 1.0),
])  # fmt: skip
def test_a_drive_split_of_minus_a_half_makes_four_driven_wheels_two(
    speed, yaw_rate, slip_angle, wheel, accel
):
    """But for the slip of rear wheels that carry twice the force, small with stiff tyres."""
    stiff = CAR._replace(c_x=1e4)
    state = ORIGIN._replace(speed=speed, yaw_rate=yaw_rate, slip_angle=slip_angle)
    split = EFFECTS["drive_split"]
    halves = Model(stiff, (split,), ((-0.5,),), make_planar("all"))
    all_four, rear = (Model(stiff, chassis=make_planar(drive)) for drive in ("all", "rear"))
    models = (halves, all_four, rear)
    rates = (model_rates(FLOAT, model, stiff, (), state, wheel, accel) for model in models)
    got, four, two = map(np.array, rates)
    off, apart = np.abs(got - two), np.abs(four - two)
    assert (off <= 0.25 * apart + 1e-3).all(), (got, four, two)


@pytest.mark.parametrize("slip", [1e-4, 0.1, 0.4, 3.0])
@pytest.mark.parametrize("p", [0.3, 0.8, 1.3])
def test_friction_scales_where_tyres_level_off_and_their_slope_as_far_as_it_says(p, slip):
    """At slope 0 by Pacejka's similarity, p F0(slip / p); at slope 1 the whole force, p F0."""

    def force(at, car=CAR):
        return tyres("tyre_saturation", (1.656, 0.496), Axles(at, 0.0), car=car).front

    stiff, soft = (EFFECTS["tyre_friction"].car(FLOAT, (p, s), CAR, ORIGIN, 0.0) for s in (0, 1))
    assert force(slip, stiff) == pytest.approx(p * force(slip / p))
    assert force(slip, soft) == pytest.approx(p * force(slip))


@pytest.mark.parametrize("shares", [(1.0, 1.0), (0.0, 4.0)], ids=["all four", "rear alone"])
def test_the_ellipse_takes_from_each_axle_what_its_drive_uses(shares):
    slips, accel = Axles(0.05, 0.04), 3.0
    whole = lateral_forces(CAR, slips, loads_at(CAR, accel))
    used = accel / (CAR.mu * GRAVITY)
    found = tyres("friction_ellipse", shares, slips, accel)
    left = [f * math.sqrt(1.0 - s * used**2) for f, s in zip(whole, shares, strict=True)]
    assert found == pytest.approx(left)


def test_lateral_transfer_costs_grip_with_the_square_of_lateral_acceleration():
    slips = Axles(0.05, 0.05)
    whole = lateral_forces(CAR, slips, REST)
    found = tyres("lateral_load_transfer", (0.5, 0.6), slips)
    lateral = (found.front + found.rear) / (CAR.mass * GRAVITY)
    assert found.front == pytest.approx(whole.front * (1.0 - 0.5 * lateral**2))


def test_what_falls_with_load_across_the_car_does_so_along_it():
    """Two wheels with mu (1 - e (load - 1)) lose e s^2 with s moved; one axle e s under it."""
    e, moved, accel = 0.4, 0.5, 2.0
    pair = sum(0.5 * load * (1.0 - e * (load - 1.0)) for load in (1.0 + moved, 1.0 - moved))
    assert pair == pytest.approx(1.0 - e * moved**2)
    slips, loads = Axles(1e-6, 1e-6), loads_at(CAR, accel)
    whole = lateral_forces(CAR, slips, loads)
    found = tyres("lateral_load_transfer", (e * moved**2, moved), slips, accel)
    assert found.rear == pytest.approx(whole.rear * (1.0 - e * (loads.rear / REST.rear - 1.0)))
    assert found.front > whole.front


def test_drag_is_the_deceleration_of_a_car_left_to_roll():
    model = Model(CAR, (EFFECTS["rolling_drag"],), ((0.8,),))
    moment = start(model, ORIGIN._replace(speed=3.0), 0.0)
    for _ in range(100):
        moment = glide(FLOAT, model, moment, 0.0, 0.0, 0.0, 0.01)
    assert moment.state.speed == pytest.approx(3.0 - 0.8, abs=1e-6)


def test_scrub_with_drag_one_takes_the_power_of_slip():
    turn = steady_turn(2.0, 0.8)
    v, r, beta = turn.speed, turn.yaw_rate, turn.slip_angle
    slips = Axles(turn.steer - beta - CAR.lf * r / v, CAR.lr * r / v - beta)
    found = EFFECTS["scrub"].rates(FLOAT, (0.0, 1.0), contact(slips, state=turn), Rates(*[0.0] * 6))
    power = sum(f * s * v for f, s in zip(lateral_forces(CAR, slips, REST), slips, strict=True))
    assert -found.speed * CAR.mass * v == pytest.approx(power, rel=1e-9)


def test_slope_pulls_downhill_and_spins_the_wheels_up_along_the_path_alone():
    for yaw, sign in ((0.0, 1.0), (math.pi, -1.0), (math.pi / 2, 0.0)):
        moved = glided("floor_slope", (0.01, 0.0, 0.0), yaw=yaw, h=0.01)
        gained = (moved.speed - 2.0) / 0.01
        assert gained == pytest.approx(sign * 0.01 * GRAVITY, abs=1e-3)
    down, across = (glided("floor_slope", (0.01, 0.0, 0.25), yaw=y) for y in (0.0, math.pi / 2))
    assert (down.speed - 2.0) / 0.001 == pytest.approx(0.01 * GRAVITY / 1.25, rel=1e-2)
    assert 2.0 * across.slip_angle / 0.001 == pytest.approx(-0.01 * GRAVITY, rel=0.1)


def test_slip_leaves_the_car_behind_its_wheels_while_they_accelerate_it():
    for accel in (3.0, -3.0):
        speed = (glided("wheel_slip", (0.01,), accel=accel).x - ORIGIN.x) / 0.001
        assert speed == pytest.approx(2.0 * (1.0 - 0.01 * accel), rel=2e-3)


def test_a_patch_is_slippery_inside_and_not_outside():
    effect, values = EFFECTS["grip_patch"], (2.0, 1.0, 0.5, 0.4, 0.0)

    def mu(x: float, y: float) -> float:
        now: float = effect.car(FLOAT, values, CAR, ORIGIN._replace(x=x, y=y), 0.0).mu
        return now / CAR.mu

    assert mu(2.0, 1.0) == pytest.approx(0.6, abs=0.01)
    assert mu(2.5, 1.0) == pytest.approx(0.8)
    assert mu(3.0, 1.0) == pytest.approx(1.0, abs=1e-3)


def test_payload_is_a_smaller_inertia_and_a_weaker_motor():
    heavy = drive("mass", (0.5, 1.0), ORIGIN._replace(speed=2.0), Command(0.2, 3.5))
    share = CAR.mass / (CAR.mass + 0.5)
    lighter = {n: share * getattr(CAR, n) for n in ("accel_max", "decel_max", "inertia_z")}
    model = Model(CAR._replace(speed_lag=CAR.speed_lag / share, **lighter))
    begun = start(model, ORIGIN._replace(speed=2.0), 0.0)
    weak = simulate(FLOAT, model, begun, [Command(0.2, 3.5)] * 200, 0.005)
    assert tuple(heavy[-1].state) == pytest.approx(tuple(weak[-1].state), rel=1e-9)


def test_speed_scale_changes_true_speed_and_not_the_reported_one():
    last = drive("speed_scale", (1.1,), ORIGIN, Command(0.0, 2.0), 3.0)[-1].state
    assert last.speed == pytest.approx(2.2, rel=1e-6)
    assert seen("speed_scale", (1.1,), last).wheel_speed == pytest.approx(2.0, rel=1e-6)


def test_battery_sag_over_a_minute():
    found = EFFECTS["battery_sag"].reference(FLOAT, (0.1,), Command(0.1, 2.0), 60.0)
    assert found == pytest.approx((0.1, 2.0 * math.exp(-0.1)))


def seen(name: str, values: tuple[float, ...], state: State[float]):
    return observe(FLOAT, Model(CAR, (EFFECTS[name],), (values,)), state)


def test_instruments_see_the_marker_and_the_body_not_the_car():
    at = ORIGIN._replace(x=1.0, y=2.0, yaw=math.pi / 2)
    assert seen("marker_offset", (0.03, 0.01), at)[:2] == pytest.approx((1.0 - 0.01, 2.0 + 0.03))
    assert seen("mocap_yaw", (0.02,), at).yaw == pytest.approx(math.pi / 2 + 0.02)
    assert seen("cog_offset", (0.02,), at)[:2] == pytest.approx((1.0, 2.0 - 0.02))


@pytest.mark.parametrize(("name", "value", "angle", "wheel"), [
    ("steer_asymmetry", 0.1, 0.2, 0.22), ("steer_asymmetry", 0.1, -0.2, -0.18),
    ("steer_nonlinearity", -1.0, 0.3, 0.273),
])  # fmt: skip
def test_the_linkage_maps_servo_to_wheel(name, value, angle, wheel):
    linkage = EFFECTS[name].linkage
    assert linkage(FLOAT, (value,), (), angle)[0] == pytest.approx(wheel)


def test_limits_only_ever_lower():
    for name, value, field in (("steer_rate_limit", 2.0, "steer_rate"),
                               ("accel_limit", 3.0, "accel_max"),
                               ("accel_limit", 3.0, "decel_max")):  # fmt: skip
        hook = EFFECTS[name].car
        assert getattr(hook(FLOAT, (value,), CAR, ORIGIN, 0.0), field) == value
        assert getattr(hook(FLOAT, (19.0,), CAR, ORIGIN, 0.0), field) == getattr(CAR, field)
    stop = EFFECTS["steer_clip"].reference
    assert stop(FLOAT, (0.2,), Command(-0.3, 1.0), 0.0) == (-0.2, 1.0)


# Effects by name: what a command line may say and what a wrong one reports.
@pytest.mark.parametrize(("text", "found"), [
    ("steer_delay=0.03", [("steer_delay", (0.03,))]),
    ("grip_patch=1,-2, 0.5,0.3", [("grip_patch", (1.0, -2.0, 0.5, 0.3, 0.0))]),
    ("grip_patch:drop=0.3,x=2", [("grip_patch", (2.0, 0.0, 0.5, 0.3, 0.0))]),
    ("floor_slope=0.01,0.02,backlash:play=0.02,mu=0.6",
     [("floor_slope", (0.01, 0.02, 0.0)), ("steer_backlash", (0.02,)),
      ("tyre_friction", (0.6, 0.0))]),
    # A name that is a parameter too starts a new effect after plain values.
    ("steer_gain=0.9,mass=0.5", [("steer_gain", (0.9,)), ("mass", (0.5, 1.0))]),
])  # fmt: skip
def test_effects_are_read_in_order_and_by_name(text, found):
    assert [(effect.name, values) for effect, values in parse_effects(text)] == found


def test_aliases_lead_to_effects_and_hide_none():
    assert not set(ALIASES) & set(EFFECTS)
    assert sum(len(e.aliases) for e in EFFECTS.values()) == len(ALIASES)
    for alias, name in ALIASES.items():
        assert find_effect(alias) is EFFECTS[name]


@pytest.mark.parametrize(("text", "says"), [
    ("steer_dely=0.03", "did you mean 'steer_delay'"), ("zzzz=1", "steerd effects"),
    ("steer_delay", "NAME=VALUE"), ("", "NAME=VALUE"), ("steer_delay=", "must be a number"),
    ("steer_delay=soon", "delay must be a number, not 'soon'"),
    ("steer_delay=nan", "outside 0 to 0.3"), ("steer_delay=inf", "outside"),
    ("steer_delay=3", "delay is 3 s, outside 0 to 0.3"),
    ("steer_delay=0.1,0.2", "takes delay, not 2 values"),
    ("steer_delay:lag=0.1", "takes delay, not 'lag'"), ("grip_patch:x=1,2", "NAME=VALUE"),
])  # fmt: skip
def test_a_wrong_line_is_named_with_its_problem(text, says):
    with pytest.raises(ValueError, match=says.replace("(", r"\(")):
        parse_effects(text)
