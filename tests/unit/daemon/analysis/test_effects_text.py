"""`steerd effects`: every line of every effect fits the narrowest terminal."""

import pytest

from steerd.car_model.effects import EFFECTS
from steerd.daemon.analysis.effects_text import format_effect, format_table
from steerd.daemon.common.screen import WIDTH


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_fits_the_terminal_and_loses_no_word(name):
    effect, text = EFFECTS[name], format_effect(EFFECTS[name])
    assert max(map(len, text.splitlines())) <= WIDTH
    words = text.split()
    for part in (effect.summary, effect.equation, *(p.meaning for p in effect.parameters)):
        assert set(part.split()) <= set(words)


def test_the_table_fits_too():
    assert max(map(len, format_table(WIDTH).splitlines())) <= WIDTH
