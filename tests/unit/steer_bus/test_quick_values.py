"""A value with a quick `__init__` is the value that the dataclass itself would make."""

import copy
import inspect
import pickle
from dataclasses import FrozenInstanceError, dataclass, field, fields, replace

import pytest

from steerd.steer_bus.quick_values import changed, quick_value


@dataclass(frozen=True, slots=True)
class Plain:
    x: float
    y: int = 3
    text: str | None = None


@quick_value
class Quick:
    x: float
    y: int = 3
    text: str | None = None


@pytest.mark.parametrize("args", [((1.0,), {}), ((1.0, 2), {"text": "a"}), ((), {"x": 0.5})])
def test_same_fields_from_the_same_arguments(args):
    given, named = args
    plain, quick = Plain(*given, **named), Quick(*given, **named)
    assert repr(quick) == repr(plain).replace("Plain", "Quick")
    assert (replace(quick, y=9), hash(quick)) == (Quick(plain.x, 9, plain.text), hash(plain))
    with pytest.raises(FrozenInstanceError):
        quick.x = 2.0


def test_the_same_arguments_are_refused():
    names = [list(inspect.signature(cls).parameters) for cls in (Plain, Quick)]
    assert names[0] == names[1]
    with pytest.raises(TypeError, match="Missing required argument 'x'"):
        Quick()
    with pytest.raises(TypeError, match="Unexpected keyword argument 'z'"):
        Quick(1.0, z=2)


class Checked:
    x: float

    def __post_init__(self):
        raise AssertionError


class Made:
    x: list[float] = field(default_factory=list)


class More(Plain):
    z: float = 0.0


@pytest.mark.parametrize("cls", [Checked, Made, More])
def test_what_it_cannot_stand_for_is_refused(cls):
    with pytest.raises(TypeError):
        quick_value(cls)


@quick_value
class Named:
    """What it is for."""

    x: float
    near: Quick = Quick(1.0)


def test_a_quick_value_is_a_dataclass_that_goes_through_a_pipe_and_changes_into_another():
    one = Named(1.0)
    assert fields(one)[1].default == Quick(1.0)
    assert pickle.loads(pickle.dumps(one)) == one == copy.deepcopy(one)
    assert changed(one, x=2.0) == Named(2.0) == replace(one, x=2.0)
    assert one.x == 1.0
    with pytest.raises(TypeError):
        changed(one, z=2.0)
    assert Named.__doc__ == "What it is for."
