"""Values in a notebook: short inside others, the screen on their own."""

from dataclasses import dataclass

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
