"""Options of a run as JSON: they return as they were, unknown types are refused."""

import msgspec
import pytest

from steerd.daemon.settings.run_options import (
    ControllerKind,
    RunOptions,
    decode_options,
    encode_options,
)


def test_options_return_from_json_as_they_were():
    options = RunOptions(
        "car.toml", port="/dev/ttyACM0", controller=ControllerKind.ZENOH, effects=("a", "b=2"),
        duration_s=2.5, ros_domain=7,
    )  # fmt: skip
    assert decode_options(encode_options(options)) == options


@pytest.mark.parametrize("text", ['{"car_file": 1}', "{}", '{"car_file": "", "controller": "x"}'])
def test_text_that_is_no_options_is_refused(text):
    with pytest.raises(msgspec.ValidationError):
        decode_options(text)
