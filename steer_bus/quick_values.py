"""Frozen dataclasses that are made quickly.

A frozen dataclass's own ``__init__`` goes through ``object.__setattr__`` for each field, which
takes twice as long as its slots' descriptors do. A tick of the loop makes some seventy such values
with four hundred fields.
"""

from dataclasses import MISSING, fields
from typing import Any, TypeVar

C = TypeVar("C", bound=type[Any])


def quick_init(cls: C) -> C:
    """Give a frozen dataclass with slots an ``__init__`` of the same arguments in less time.

    Raises:
        TypeError: it has no slots, a ``__post_init__``, or a field that a plain argument cannot
            stand for (a factory's, keyword-only, not of ``__init__``).
    """
    own = fields(cls)
    if hasattr(cls, "__post_init__") or "__slots__" not in vars(cls):
        raise TypeError(f"{cls.__name__} needs slots, and no __post_init__")
    if any(f.default_factory is not MISSING or f.kw_only or not f.init for f in own):
        raise TypeError(f"{cls.__name__} has a field that is no plain argument")
    scope: dict[str, Any] = {f"set_{f.name}": getattr(cls, f.name).__set__ for f in own}
    scope |= {f"default_{f.name}": f.default for f in own if f.default is not MISSING}
    given = [f.name if f.default is MISSING else f"{f.name}=default_{f.name}" for f in own]
    body = "".join(f"    set_{f.name}(self, {f.name})\n" for f in own) or "    pass\n"
    exec(f"def __init__({', '.join(['self', *given])}):\n{body}", scope)
    scope["__init__"].__qualname__ = f"{cls.__qualname__}.__init__"
    cls.__init__ = scope["__init__"]
    return cls
