import math
from dataclasses import asdict, fields

import pytest

from steerd.estimator.config import FilterConfig, load_filter_config


def test_defaults_pass_their_own_validation():
    assert load_filter_config(asdict(FilterConfig())) == FilterConfig()
    assert load_filter_config({}) == FilterConfig()


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ({"pose_sd": 0.1}, "unknown key 'pose_sd' (known: pose_position_sd"),
        ({"gyro_sd": "much"}, "gyro_sd must be a number, not 'much'"),
        ({"gyro_sd": True}, "gyro_sd must be a number, not True"),
        ({"gyro_sd": -1.0}, "gyro_sd = -1.0 is outside 1e-06 .. 10"),
        ({"wheel_speed_sd": 0.0}, "wheel_speed_sd = 0.0 is outside"),
        ({"history_s": 0.3}, "history_s = 0.3 is outside 0.5 .. 2"),
        ({"initial_poses": 7.5}, "initial_poses must be a whole number"),
    ],
)
def test_each_problem_is_named(mapping, words):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        load_filter_config(mapping)
    assert words in str(caught.value)


@pytest.mark.parametrize("name", [field.name for field in fields(FilterConfig)])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_no_field_takes_nonsense(name, bad):
    with pytest.raises(ValueError, match=name):
        load_filter_config({name: bad})
