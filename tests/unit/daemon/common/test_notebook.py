"""Values in a notebook: short inside others, the screen on their own."""

from dataclasses import dataclass

import pytest

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.notebook import notebook_progress, speaking_of_arguments
from steerd.daemon.common.screen import shown


@shown
@dataclass(frozen=True)
class Screen:
    text: str

    def __str__(self) -> str:
        return self.text


def test_a_value_is_one_line_inside_others_and_its_screen_at_a_cells_end():
    value = Screen("drives      one\nverdict     NONE. No gap < noise\nnext        nothing")
    assert repr([value]) == "[<steerd.Screen: verdict NONE. No gap < noise>]"
    assert value._repr_html_().startswith("<pre>drives")
    assert "gap &lt; noise" in value._repr_html_()
    assert repr(Screen("drive.mcap\n  car  car1")) == "<steerd.Screen: drive.mcap>"


@pytest.mark.parametrize(("said", "shown_as"), [
    ("name one with --base car.toml", "name one with base='car.toml'"),
    ("--held-out 0, or name a session", "held_out=0, or name a session"),
    ("--effect: no effect 'wings'", "effects: no effect 'wings'"),
    ("run `steerd collect --plan mixed`", "run `steerd collect --plan mixed`"),
])  # fmt: skip
def test_errors_speak_of_arguments(said, shown_as):
    @speaking_of_arguments
    def refuse():
        raise SteerdError(said, said)

    with pytest.raises(SteerdError) as refused:
        refuse()
    assert (refused.value.what, refused.value.hint) == (shown_as, shown_as)


def test_outside_a_notebook_progress_shows_nothing(capfd):
    with notebook_progress("driving", 2.0) as move:
        move(1.0, "half")
    assert capfd.readouterr() == ("", "")
