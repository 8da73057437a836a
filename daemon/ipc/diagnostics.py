"""Reading of the core's diagnostics message, for terminals."""

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import remove_controls
from steerd.steer_bus.standard import DiagnosticArray


def read_diagnostics(message: DiagnosticArray) -> dict[str, str]:
    """The supervisor's values in a diagnostics message.

    Raises:
        SteerdError: the message is not the supervisor's.
    """
    for status in message.status:
        if status.name == "steerd: supervisor":
            return {value.key: remove_controls(value.value) for value in status.values}
    raise SteerdError("this is no steerd diagnostics message")
