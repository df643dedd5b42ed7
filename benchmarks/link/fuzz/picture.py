"""The complete state of an object as one comparable value, so that "nothing changed" can be asked of all of it."""

from collections import deque
from dataclasses import fields, is_dataclass
from enum import Enum

import numpy as np

_still: set[type] = {type(None), int, float, str, bytes, bool, tuple}  # what cannot change
_names: dict[type, tuple[str, ...]] = {}


def _names_of(kind: type) -> tuple[str, ...]:
    """Attributes to look into; none: what it holds is in its __dict__, or it does not change."""
    if kind not in _names:
        parameters = getattr(kind, "__dataclass_params__", None)
        _names[kind] = ()
        if issubclass(kind, Enum | int) or (parameters is not None and parameters.frozen):
            _still.add(kind)
        elif is_dataclass(kind):
            _names[kind] = tuple(f.name for f in fields(kind))
    return _names[kind]


def picture(thing: object, without: frozenset[str] = frozenset()) -> object:
    """All mutable state below `thing`; attributes named in `without` are left out."""
    kind = type(thing)
    if isinstance(thing, np.ndarray):
        return thing.tobytes()
    if isinstance(thing, list | deque):
        return tuple([item if type(item) in _still else picture(item, without) for item in thing])
    if isinstance(thing, dict):
        return tuple(
            [(key, value if type(value) in _still else picture(value, without)) for key, value in thing.items()]
        )
    names = _names_of(kind)
    if kind in _still or callable(thing):
        return thing
    if names:
        return tuple(
            [
                value if type(value) in _still else picture(value, without)
                for value in [getattr(thing, name) for name in names if name not in without]
            ]
        )
    inside = getattr(thing, "__dict__", None) or {}
    return tuple([picture(value, without) for name, value in inside.items() if name not in without])
