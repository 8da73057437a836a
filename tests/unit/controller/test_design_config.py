"""Settings: defaults, forms of poles, and what a wrong one reports."""

import pytest

from steerd.controller.config import (
    PAPER_POLES,
    ControllerConfig,
    LqrWeights,
    load_controller_config,
)


def test_nothing_given_is_the_default() -> None:
    config = load_controller_config({})
    assert config == ControllerConfig()
    assert config.design == "lqr"
    assert config.poles == PAPER_POLES == (-2 + 2j, -2 - 2j, -150 + 15j, -150 - 15j)
    assert config.start_ramp == config.stop_ramp == 1.5


def test_a_whole_table() -> None:
    config = load_controller_config(
        {
            "design": "pole_placement",
            "poles": ["-3 + 1j", [-3, -1], -90, "-50"],
            "weights": {"e1": 9, "effort": 2.0},
            "speed": 2,
            "file_speeds": False,
        }
    )
    assert config.poles == (-3 + 1j, -3 - 1j, -90, -50)
    assert config.weights == LqrWeights(e1=9.0, effort=2.0)
    assert config.speed == 2.0
    assert not config.file_speeds


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"desing": "lqr"}, "did you mean design"),
        ({"xyz": 1}, "known are"),
        ({"design": "mpc"}, "use lqr or pole_placement"),
        ({"design": 3}, "must be a str"),
        ({"file_speeds": 1}, "must be a bool"),
        ({"speed": "fast"}, "must be a number"),
        ({"speed": True}, "must be a number"),
        ({"speed": 0.0}, "must be positive"),
        ({"speed": float("nan")}, "must be positive"),
        ({"speed": 300}, "above"),
        ({"damping_min": 1.0}, "damping_min"),
        ({"grid_spacing": 1e-9}, "grid_spacing"),
        ({"weights": {"e2_rat": 1.0}}, "did you mean e2_rate"),
        ({"weights": 4}, "must be a table"),
        ({"weights": {"effort": 0.0}}, "must be positive"),
        ({"weights": {"e2": -1.0}}, "weights.e2"),
        ({"poles": "-2"}, "must be a list"),
        ({"poles": ["-2", "-3"]}, "four states"),
        ({"poles": ["-2", "-3", "-4", "x"]}, "is no pole"),
        ({"poles": [-2, -3, -4, 5]}, "negative real part"),
        ({"poles": ["-2+2j", "-2", "-3", "-4"]}, "conjugate pairs"),
    ],
)
def test_a_wrong_setting_is_named_with_its_problem(table: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        load_controller_config(table)
