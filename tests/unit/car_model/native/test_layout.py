"""Row numbers by name point at what they say."""

import pytest

from steerd.car_model.effects import find_effect
from steerd.car_model.native.print_c import row_layout
from steerd.car_model.native.trace import CHASSIS, trace
from steerd.car_model.state import State


@pytest.mark.parametrize("names", [(), ("tyre_relaxation",), ("steer_backlash", "tyre_relaxation")])
def test_every_row_is_the_input_of_its_name(names):
    traced = trace(tuple(find_effect(name) for name in names))
    rows, entries = row_layout(traced), traced.tape.entries

    def inputs(piece):
        return [entries[node.place].name for node in piece.inputs]

    actuators, rates, remember = map(inputs, (traced.actuators, traced.rates, traced.remember))
    command = rows["ACTUATORS_COMMAND"]
    assert actuators[: rows["STATES"]] == list(State._fields)
    assert actuators[command : command + 2] == ["cmd_steer", "cmd_speed"]
    assert actuators[rows["ACTUATORS_TIME"]] == rates[rows["RATES_TIME"]] == "t"
    assert rates[: rows["CHASSIS"]] == list(CHASSIS)
    assert (rates[rows["RATES_WHEEL"]], rates[rows["RATES_ACCEL"]]) == ("wheel", "accel")
    assert remember[rows["REMEMBER_AFTER"] + rows["STEER"]] == "steer_after"
    assert remember[rows["REMEMBER_TIME"] :] == ["t"]
    assert len(remember) == rows["REMEMBER_INPUTS"]
    assert actuators[rows["SPEED"]] == "speed"
    assert rows["ACTUATORS_OUTPUTS"] == rows["MEMORY_END"] + rows["MEMORY"]


def test_the_steer_is_the_last_state():
    assert State._fields == (*CHASSIS, "steer")
