"""Frozen dataclasses that are made quickly.

A tick of the loop makes some seventy such values with four hundred fields. A frozen dataclass's
own ``__init__`` is Python and goes through ``object.__setattr__`` for each field; msgspec's
structures are filled in C, in an eighth of the time.
"""

# Why: docs/decisions/rooms-and-code.md#d93

from dataclasses import MISSING, FrozenInstanceError, dataclass, fields
from typing import Any, NoReturn, TypeVar, cast, dataclass_transform

from msgspec import defstruct
from msgspec.structs import replace

C = TypeVar("C", bound=type[Any])
V = TypeVar("V")

_MADE_ANEW = ("__init__", "__slots__", "__getstate__", "__setstate__", "__annotations__",
              "__weakref__", "__dict__")  # fmt: skip


def changed(value: V, **fields: Any) -> V:
    """A quick value with other values in some fields: `dataclasses.replace` in less time."""
    return replace(value, **fields)  # type: ignore[type-var]


@dataclass_transform(frozen_default=True)
def quick_value(cls: C) -> C:
    """Class decorator: a frozen dataclass with slots, made in less time from the same arguments.

    It is a dataclass for whoever asks `dataclasses`, with the same methods, hash and text.

    Raises:
        TypeError: it has a base, a ``__post_init__``, or a field that a plain argument cannot stand
            for (a factory's, keyword-only, not of ``__init__``).
    """
    plain: Any = dataclass(frozen=True, slots=True)(cls)
    own = fields(plain)
    if hasattr(cls, "__post_init__") or cls.__bases__ != (object,):
        raise TypeError(f"{cls.__name__} has a base or a __post_init__")
    if any(f.default_factory is not MISSING or f.kw_only or not f.init for f in own):
        raise TypeError(f"{cls.__name__} has a field that is no plain argument")
    names = {f.name for f in own}
    kept = {k: v for k, v in vars(plain).items() if k not in names and k not in _MADE_ANEW}
    typed = [(f.name, f.type) if f.default is MISSING else (f.name, f.type, f.default) for f in own]
    kept["__qualname__"] = cls.__qualname__
    made: Any = defstruct(cls.__name__, typed, namespace=kept, frozen=True)
    made.__setattr__ = made.__delattr__ = _refuse  # the library's own error is a wider one
    return cast("C", made)


def _refuse(self: Any, name: str, value: Any = None) -> NoReturn:
    raise FrozenInstanceError(f"cannot change field {name!r}")
