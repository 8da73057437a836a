"""From hypotheses to a verdict: no car is simulated here."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from steerd.car_model.effects import EFFECTS
from steerd.sim_gap.verdict.confidence import base_strain, judge_case
from steerd.sysid.inference import constants as c
from steerd.sysid.inference.augmented_car import Control
from steerd.sysid.inference.hypotheses import Findings
from steerd.sysid.inference.odds import Hypothesis

SMALL, LARGE = 0.5 * c.GAP_SIZE, 4.0 * c.GAP_SIZE
VALUES = {"steer_delay": (0.03,), "steer_lag": (0.05,), "mass": (1.5, 1.0), "yaw_inertia": (1.5,),
          "lateral_load_transfer": (0.1, 1.0), "marker_offset": (0.01, 0.0),
          "cornering_stiffness": (1.3,), "accel_limit": (1.5,)}  # fmt: skip
NAMES = [f"{name}.{p.name}" for name in VALUES for p in EFFECTS[name].parameters]
AUGMENTED = SimpleNamespace(
    places=lambda name: [i for i, n in enumerate(NAMES) if n.startswith(f"{name}.")],
    values=lambda name: EFFECTS[name].nulls,
)
PREDICTOR = SimpleNamespace(augmented=AUGMENTED)
LIKELIHOOD = SimpleNamespace(predictor=PREDICTOR, left=0.0)
LIBRARY = SimpleNamespace(effect=EFFECTS.get, likelihood=LIKELIHOOD, controls={})


def _hypothesis(*effects, probability=1.0, size=SMALL, moved=0.0, values=None, spun=0):
    """A hypothesis whose base of 20 parameters costs `moved` nats beyond its mean.

    Of its ten windows `spun` leave more than counts.
    """
    given = {**VALUES, **(values or {})}
    free = [n for n in NAMES if n.partition(".")[0] in effects]
    chart = SimpleNamespace(free=free)
    space = SimpleNamespace(nuisance=20, base_cost=lambda z: 10.0 + moved, chart=chart)
    point = SimpleNamespace(
        space=space, z=np.zeros(20), size=size, parameters=np.concatenate(list(given.values())),
        at=SimpleNamespace(spun=np.arange(10) < spun),
    )  # fmt: skip
    posterior = SimpleNamespace(point=point, covariance=1e-6 * np.eye(len(free)))
    return Hypothesis(effects, posterior, 0.0, probability)


def _found(*hypotheses, before=LARGE, excess=(0.0, 0.0)):
    """Hypotheses, and the base alone with what probability they leave."""
    left = 1.0 - sum(h.probability for h in hypotheses)
    every = [*hypotheses, _hypothesis(probability=left, size=before)]
    every.sort(key=lambda h: -h.probability)
    return Findings(tuple(every), SimpleNamespace(size=before), (), excess)


@pytest.mark.parametrize("share", [SMALL / LARGE, 0.3, 0.45])
def test_a_cause_is_as_sure_as_every_hypothesis_that_has_it_but_for_what_stays(share):
    """A name that gains beyond doubt and leaves half of the gap is no sure name."""
    alone = _hypothesis("steer_delay", probability=0.6, size=share * LARGE)
    pair = _hypothesis("steer_delay", "mass", probability=0.3)
    told = judge_case(LIBRARY, _found(alone, pair), True)
    assert told.name == ("explained" if share * LARGE == SMALL else "partial")
    (cause,) = told.causes
    assert (cause.effect, cause.stage, cause.family) == ("steer_delay", "command", "timing")
    sd = np.hypot(1e-3, 0.03 * c.MODEL_ERROR)
    assert cause.parameters == {"delay": (0.03, pytest.approx(sd), "s")}
    kept = 1.0 - share**2
    assert cause.confidence == pytest.approx(0.9 * kept)
    assert told.something_else == pytest.approx(1.0 - 0.9 * kept)
    assert told.left == pytest.approx(share)


@pytest.mark.parametrize(("each", "names"), [(0.3, 1), (0.2, 0)])
def test_a_gap_that_is_likelier_than_none_has_a_name(each, names):
    shared = [_hypothesis(n, probability=each) for n in ("cornering_stiffness", "marker_offset")]
    assert len(judge_case(LIBRARY, _found(*shared), True).causes) == names


@pytest.mark.parametrize("later", ["steer_delay", "mass"])
def test_the_cause_without_which_the_odds_fall_most_is_named_first(later):
    both = replace(_hypothesis("steer_delay", "mass", probability=0.8), log_odds=50.0)
    odds = {n: 10.0 if n == later else 40.0 for n in both.effects}
    alone = [replace(_hypothesis(n, probability=0.0), log_odds=o) for n, o in odds.items()]
    first, second = judge_case(LIBRARY, _found(both, *alone), True).causes
    assert (second.effect, {first.effect, second.effect}) == (later, {"steer_delay", "mass"})


def test_a_gap_too_far_off_to_count_is_measured_by_its_errors():
    """A delay of 0.1 s leaves the windows so far off that the likeliest size stays small."""
    found = _found(_hypothesis("steer_delay", size=0.75 * LARGE), excess=(50.0, 0.08))
    told = judge_case(LIBRARY, found, True)
    assert (told.name, told.left) == ("partial", pytest.approx(0.04))
    assert judge_case(LIBRARY, replace(found, excess=(50.0, 40.0)), True).name == "unexplained"
    assert judge_case(LIBRARY, replace(found, excess=(0.0, 0.0)), True).name == "unexplained"


@pytest.mark.parametrize(("name", "other"), [
    ("cornering_stiffness", "tyre_friction"), ("yaw_inertia", "mass"), ("mass", "yaw_inertia"),
])  # fmt: skip
def test_what_differs_by_an_equations_form_alone_is_named_with_it(name, other):
    (cause,) = judge_case(LIBRARY, _found(_hypothesis(name)), True).causes
    assert cause.confidence <= c.ALIKE_MOST
    assert other in cause.ambiguous_with
    assert name != "mass" or cause.ambiguous_with == (other,)


def test_what_healthy_drives_show_of_an_effect_is_none_of_the_change():
    shown = Control("steer_delay", np.array([0.004]), np.array([[9e-6]]), 0.1)
    library = SimpleNamespace(**{**vars(LIBRARY), "controls": {"steer_delay": shown}})
    (cause,) = judge_case(library, _found(_hypothesis("steer_delay")), True).causes
    value, sd, _ = cause.parameters["delay"]
    assert value == pytest.approx(0.03 - 0.004)
    assert sd == pytest.approx(np.sqrt(1e-6 + 9e-6 + (value * c.MODEL_ERROR) ** 2))
    shown = Control("accel_limit", np.array([9.0]), np.zeros((1, 1)), 0.1)  # only where it stays
    library.controls["accel_limit"] = shown
    (cause,) = judge_case(library, _found(_hypothesis("accel_limit")), True).causes
    assert cause.parameters["limit"].value == 1.5


def test_a_wrong_model_adds_to_an_error_by_the_change_or_the_value_whichever_is_less():
    """A limit's null is out of reach; a form has no size."""
    names = {"cornering_stiffness": 0.3 * c.MODEL_ERROR_FORCES, "accel_limit": 1.5 * c.MODEL_ERROR,
             "mass": 1.5 * c.MODEL_ERROR_FORCES}  # fmt: skip
    for name, wrong in names.items():
        (cause,) = judge_case(LIBRARY, _found(_hypothesis(name)), True).causes
        own, *forms = (each.sd for each in cause.parameters.values())
        assert own == pytest.approx(np.hypot(1e-3, wrong))
        assert forms == pytest.approx([1e-3] * len(forms))


@pytest.mark.parametrize(("effects", "changes", "known", "verdict"), [
    # The base alone is no gap, or one without a name: noise that was learnt from the same
    # drives lets a gap pass for noise. Losses are bounded: where most windows are far off, no
    # discrepancy costs least.
    ((), {"size": SMALL}, True, "none"),
    ((), {"size": LARGE}, True, "unexplained"),
    ((), {"size": LARGE}, False, "none"),
    ((), {"size": 0.0, "spun": 9}, True, "unexplained"),
    # What stays beside a cause, and what the base gave, limit the verdict.
    (("steer_delay",), {}, True, "explained"),
    (("steer_delay",), {"size": 1.2 * c.GAP_SIZE}, True, "partial"),
    (("steer_delay",), {"size": 0.9 * LARGE}, True, "unexplained"),
    (("steer_delay",), {"size": 0.9 * LARGE}, False, "explained"),
    (("steer_delay",), {"size": 0.0, "spun": 6}, True, "unexplained"),
    (("steer_delay",), {"size": 0.0, "spun": 2}, True, "explained"),
    (("steer_delay",), {"moved": 0.6 * c.STRAINED * np.sqrt(40.0)}, True, "partial"),
    (("steer_delay",), {"moved": 0.4 * c.STRAINED * np.sqrt(40.0)}, True, "explained"),
])  # fmt: skip
def test_what_stays_and_what_the_base_gave_make_the_verdict(effects, changes, known, verdict):
    best = _hypothesis(*effects, **changes)
    told = judge_case(LIBRARY, replace(_found(), hypotheses=(best, _hypothesis())), known)
    assert told.name == verdict
    named = [*effects] if verdict in ("explained", "partial") else []
    assert [cause.effect for cause in told.causes] == named


def test_names_that_leave_most_of_a_gap_too_small_to_count_are_not_said():
    found = _found(_hypothesis("steer_delay", probability=0.6), before=SMALL)
    told = judge_case(LIBRARY, found, True)
    assert (told.name, told.causes, told.something_else) == ("unexplained", (), 1.0)


@pytest.mark.parametrize(("name", "values", "told"), [
    ("yaw_inertia", (EFFECTS["yaw_inertia"].parameters[0].high,), True),
    ("yaw_inertia", (1.5,), False), ("yaw_inertia", EFFECTS["yaw_inertia"].nulls, False),
    ("lateral_load_transfer", (1.0, EFFECTS["lateral_load_transfer"].parameters[1].high), False),
    ("lateral_load_transfer", (EFFECTS["lateral_load_transfer"].parameters[0].high, 0.6), True),
])  # fmt: skip
def test_a_value_at_its_bound_explains_a_part_at_most(name, values, told):
    """The form of an effect may lie at its bound, its size may not."""
    found = judge_case(LIBRARY, _found(_hypothesis(name, values={name: values})), True)
    assert found.at_bound == ((name,) if told else ())
    assert found.name == ("partial" if told else "explained")


def test_what_may_be_the_cause_instead_stands_beside_the_name_and_beside_no_other():
    best = _hypothesis("steer_delay", probability=0.85)
    near = _hypothesis("steer_lag", probability=0.12)
    far = _hypothesis("yaw_inertia", probability=0.5 * c.STANDS_IN * 0.85)
    (cause,) = judge_case(LIBRARY, _found(best, near, far), True).causes
    assert cause.ambiguous_with == ("steer_lag",)
    pair = _hypothesis("steer_delay", "marker_offset", probability=0.8)
    other = _hypothesis("steer_lag", "marker_offset", probability=0.15)
    first, second = judge_case(LIBRARY, _found(pair, other), True).causes
    assert (first.ambiguous_with, second.ambiguous_with) == (("steer_lag",), ())


def test_strain_is_a_distance_in_the_bases_own_uncertainty():
    assert base_strain(_hypothesis("mass")) == pytest.approx(0.0)
    assert base_strain(_hypothesis("mass", moved=40.0)) == pytest.approx(80.0 / np.sqrt(40.0))
    held = _hypothesis("mass")
    held.point.space.nuisance = 0
    assert base_strain(held) == 0.0
