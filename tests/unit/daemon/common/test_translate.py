"""Errors of other rooms become exit codes and hints of the command line."""

from pathlib import Path

from steerd.car_model.car_file import CarFileError
from steerd.daemon.common.errors import ExitCode
from steerd.daemon.common.translate import make_car_file_error, make_session_error
from steerd.steer_bus.session_read import SessionError


def test_a_car_file_that_the_system_does_not_open_is_unreadable():
    error = CarFileError(Path("a.toml"), "", "cannot be read", "")
    error.__cause__ = OSError(13, "Permission denied")
    made = make_car_file_error(error)
    assert (made.what, made.code) == ("a.toml: cannot be read", ExitCode.UNREADABLE)


def test_a_session_error_keeps_its_own_hint_and_says_it_once():
    made = make_session_error(SessionError("exists", "a.mcap exists", "choose another name"), "no")
    assert (made.what, made.hint) == ("a.mcap exists", "choose another name")


def test_a_session_error_without_a_hint_takes_the_command_s():
    made = make_session_error(SessionError("disk", "a.mcap cannot be written"), "free some space")
    assert made.hint == "free some space"
    assert made.code == ExitCode(SessionError("disk", "x").exit_code)
