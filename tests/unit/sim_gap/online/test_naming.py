"""Changes: noticed, named, informed as a set, or left without a name."""

import numpy as np
import pytest

from steerd.sim_gap.online.changes import SPANS, ratios, suspects, unknown, with_ratios
from steerd.sim_gap.online.fitting import Fit, Point, fit_effect, is_at_bound, rank
from steerd.sim_gap.online.looking import cut
from steerd.sim_gap.online.naming import alternatives_of, name

EFFECTS = ("steer_bias", "steer_gain", "marker_offset", "tyre_friction")
OFF = {"steer_bias": 0.02, "steer_gain": -0.12, "marker_offset": 0.03, "tyre_friction": -0.4}


def finding(anchor, track, looks):
    null, fits = rank(anchor, anchor.space.effects, track, looks)
    points = {fit.effect: Point(fit.z, ()) for fit in fits}
    return name(anchor, null, fits, 1.0, points)


@pytest.mark.parametrize(("effect", "size"), OFF.items())
def test_the_effect_that_came_about_is_named(anchor, track, windows, effect, size):
    found = finding(anchor, track, windows(8, **{effect: size}))
    assert (found.verdict, found.cause.effect) == ("named", effect)
    value, sd, _ = next(iter(found.cause.parameters.values()))
    first = anchor.places(effect)[0]
    assert value == pytest.approx(anchor.space.centre[first] + size, abs=5.0 * sd)
    assert found.cause.confidence > 0.8


def test_nothing_is_named_where_nothing_changed(anchor, track, windows):
    found = finding(anchor, track, windows(8))
    assert found.verdict != "named"
    assert found.gain < 10.0


def test_a_name_takes_some_windows(anchor, track, windows):
    assert finding(anchor, track, windows(2, steer_bias=0.02)).verdict == "changed"


def test_what_no_effect_explains_stays_without_a_name(anchor, track, windows):
    found = finding(anchor, track, windows(8, left=30.0))
    assert found.verdict == "unexplained"


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("speed_scale", "rolling_drag", ()),
        ("rolling_drag", "speed_scale", ()),
        ("marker_offset", "cog_offset", ()),
        ("cornering_stiffness", "tyre_friction", ("tyre_friction",)),
        ("yaw_inertia", "mass", ("mass",)),
    ],
)
def test_a_pair_that_the_library_calls_alike_far_behind(first, second, expected):
    """The second leaves a third of the excess and is 400 nats behind."""

    def fit(effect, ratio):
        return Fit(effect, np.zeros(1), np.ones(1), np.full(16, 5.0 * ratio), np.full(16, ratio), 0)

    null, best, other = fit("", 16.0), fit(first, 1.0), fit(second, 6.0)
    points = {first: Point(np.zeros(1), ()), second: Point(np.zeros(1), ())}
    assert alternatives_of(null, [best, other], points, enough=8.5) == expected


def test_a_window_that_nothing_explains_does_not_decide(anchor, track, windows):
    looks = windows(8, steer_bias=0.02)
    wild = windows(1, left=500.0, seed=9, steer_gain=0.5)
    found = finding(anchor, track, [*looks, *wild])
    assert found.cause.effect == "steer_bias"
    value, sd, _ = found.cause.parameters["bias"]
    assert value == pytest.approx(0.02, abs=5.0 * sd)


def test_a_value_that_no_car_has_names_nothing(anchor, track, windows):
    looks = windows(8, steer_bias=0.9)
    fit = next(f for f in rank(anchor, EFFECTS, track, looks)[1] if f.effect == "steer_bias")
    assert is_at_bound(anchor, fit)
    assert fit.z[-1] == anchor.space.high[anchor.places("steer_bias")[0]]
    assert finding(anchor, track, looks).verdict == "unexplained"


def test_the_base_moves_only_within_what_is_known_of_it(anchor, track, windows):
    looks = [cut(seen, range(anchor.space.nuisance)) for seen in windows(4)]
    free = fit_effect(anchor, track, looks, "")
    held = fit_effect(anchor, track.__class__(1e9 * track.information, track.pull, track.prior),
                      looks, "")  # fmt: skip
    assert np.abs(held.z).max() < np.abs(free.z).max()


def test_ratios_rise_only_over_windows_since_the_change(anchor, track, windows):
    looks = [*windows(8), *windows(4, seed=8, steer_bias=0.02)]
    effects = anchor.space.effects
    table = ratios(suspects(anchor, effects, [track] * 12, looks), len(effects))
    bias = table[effects.index("steer_bias")]
    assert int(np.nanargmax(bias)) == SPANS.index(4)
    assert bias[SPANS.index(4)] > 50.0
    assert np.isnan(bias[SPANS.index(16)])


def test_what_a_car_shows_as_usual_is_no_change():
    shape = (2, len(SPANS))
    usual = unknown(2)
    for _ in range(200):
        usual = with_ratios(usual, np.full(shape, 9.0))
    assert (usual.level() > 8.0).all()
    quiet = unknown(2)
    for _ in range(200):
        quiet = with_ratios(quiet, np.full(shape, 0.3))
    assert (quiet.level() < 2.0).all()
