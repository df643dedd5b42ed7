"""What translated programs call: checked arithmetic, shifts, conversions, memory moves."""

import math
import struct
from typing import Any

from st_errors import StRuntimeError
from st_memory import Cell, Elements, Place, finite_part

_FLOAT32 = struct.Struct("<f")


def wrap_signed(value: int, bits: int) -> int:
    """Two's complement."""
    half = 1 << (bits - 1)
    return ((value + half) & ((1 << bits) - 1)) - half


def divide(a: int, b: int) -> int:
    """Integer division that truncates toward zero."""
    return a // b if (a >= 0) == (b > 0) else -(-a // b)


def modulo(a: int, b: int) -> int:
    """Remainder with the sign of the dividend."""
    return a - b * divide(a, b)


def float32(value: float) -> float:
    """The nearest REAL."""
    return _FLOAT32.unpack(_FLOAT32.pack(value))[0]


def to_integer(value: float, lo: int, hi: int) -> int:
    """Rounds half to even (assumption; runtimes differ); what does not fit is undefined on a PLC, so an error here."""
    number = round(value)
    if not lo <= number <= hi:
        raise StRuntimeError(f"{value!r} does not fit {lo}..{hi}: the result is undefined")
    return number


def to_integer_truncated(value: float, lo: int, hi: int) -> int:
    """The other convention: cuts toward zero."""
    return to_integer(math.trunc(value), lo, hi)


def out_of_bounds(index: int, lower: int, upper: int) -> int:
    """The error of an array index."""
    raise StRuntimeError(f"index {index} outside {lower}..{upper}")


def not_finite(value: float) -> float:
    """The error of NaN and infinity met in foreign memory."""
    raise StRuntimeError(f"{value} loaded as a number: a TwinCAT runtime could stop here")


def overflowed(value: int, type_name: str) -> int:
    """The error of an intermediate result that runtimes compute with different widths."""
    raise StRuntimeError(f"intermediate {value} outside {type_name}: assign it to a variable first, runtimes differ")


def loop_end(last: int, limit: int) -> int:
    """The end of a FOR loop; at the type's own limit the loop variable wraps and the loop never ends."""
    if last == limit:
        raise StRuntimeError(f"FOR up to {last}, the limit of the loop variable's type: the loop would never end")
    return last


def shift_count(count: int, bits: int) -> int:
    """A shift by the whole width or more: runtimes differ."""
    if not 0 <= count < bits:
        raise StRuntimeError(f"shift by {count} of {bits} bits: runtimes differ")
    return count


def square_root(value: float) -> float:
    """SQRT; of a negative number it is NaN on a PLC, so an error here."""
    if value < 0.0:
        raise StRuntimeError(f"SQRT of {value}")
    return math.sqrt(value)


def copy_items(target: Any, source: Any) -> None:
    """Array assignment, element by element, wherever either lies."""
    for index, value in enumerate(source):
        old = target[index]
        if hasattr(old, "st_set"):
            old.st_set(value)
        elif isinstance(old, list | memoryview | Elements):
            copy_items(old, value)
        else:
            target[index] = value


def filled(target: Any, source: Any) -> Any:
    """A fresh array filled from another: a copy."""
    copy_items(target, source)
    return target


def with_fields(target: Any, **values: Any) -> Any:
    """A fresh struct with some fields set."""
    for name, value in values.items():
        setattr(target, name, value)
    return target


def memory_copy(target: Place | None, source: Place | None, count: int) -> None:
    """MEMCPY."""
    if target is None or source is None:
        raise StRuntimeError("MEMCPY with a null pointer")
    target.write(source.read(count), count)


def memory_set(target: Place | None, fill: int, count: int) -> None:
    """MEMSET."""
    if target is None:
        raise StRuntimeError("MEMSET with a null pointer")
    target.write(bytes([fill]) * count, count)


NAMES = {
    "_st_wrap": wrap_signed,
    "_st_div": divide,
    "_st_mod": modulo,
    "_st_f32": float32,
    "_st_int": to_integer,
    "_st_oob": out_of_bounds,
    "_st_nan": not_finite,
    "_st_over": overflowed,
    "_st_end": loop_end,
    "_st_shift": shift_count,
    "_st_sqrt": square_root,
    "_st_items": copy_items,
    "_st_filled": filled,
    "_st_with": with_fields,
    "_st_Cell": Cell,
    "_st_Elements": Elements,
    "_st_memcpy": memory_copy,
    "_st_memset": memory_set,
    "_st_finite": finite_part,
    "_st_Place": Place,
    "_st_min": min,
    "_st_max": max,
    "_st_abs": abs,
    "_st_float": float,
    "_st_range": range,
    "_st_list": list,
    "_st_zip": zip,
}
