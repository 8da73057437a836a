"""Where the inputs and outputs of each piece stand: the row numbers of the compiled text.

A piece's workspace holds its inputs in the order in which `trace` lists them, then its outputs. The
names below are printed into every compiled module, so that no loop counts states itself.
"""

from steerd.car_model.native.trace import Traced
from steerd.car_model.state import State


def row_layout(traced: Traced) -> dict[str, int]:
    """Row numbers by name.

    Actuators: state, memory, command, time -> wheel at start and end, steer, accel, memory.
    Rates: chassis, wheel, accel, memory, time -> rates of the chassis.
    Remember: state before, state after, memory, time -> memory.
    Observe: state -> readings.
    """
    states, chassis, memory = len(State._fields), len(traced.rates.outputs), traced.memory
    return {
        "FIRST": 0,
        "ONE": 1,
        "STATES": states,
        "CHASSIS": chassis,
        "STEER": State._fields.index("steer"),
        "SPEED": State._fields.index("speed"),
        "YAW_RATE": State._fields.index("yaw_rate"),
        "MEMORY": memory,
        "ACTUATORS_COMMAND": states + memory,
        "ACTUATORS_TIME": states + memory + 2,
        "ACTUATORS_INPUTS": len(traced.actuators.inputs),
        "ACTUATORS_OUTPUTS": len(traced.actuators.outputs),
        "WHEEL_START": 0,
        "WHEEL_END": 1,
        "STEER_END": 2,
        "ACCEL": 3,
        "MEMORY_END": 4,
        "RATES_WHEEL": chassis,
        "RATES_ACCEL": chassis + 1,
        "RATES_TIME": chassis + 2 + memory,
        "RATES_INPUTS": len(traced.rates.inputs),
        "REMEMBER_AFTER": states,
        "REMEMBER_MEMORY": 2 * states,
        "REMEMBER_TIME": 2 * states + memory,
        "REMEMBER_INPUTS": len(traced.remember.inputs),
        "READINGS": len(traced.observe.outputs),
        "PARAMETER_COUNT": len(traced.parameters),
    }
