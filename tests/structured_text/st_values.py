"""Typed pieces of Python source: operators and conversions with TwinCAT's rules; masks only where needed."""

import operator
from collections.abc import Callable
from dataclasses import dataclass

import st_runtime
from st_types import ANY_INT, ANY_REAL, BOOL, ELEMENTARY, LREAL, REAL, Elementary, Enum, Pointer, Type, common, fits


class MismatchError(Exception):
    """A type error before it knows where it is."""


@dataclass(slots=True)
class Value:
    """An expression. Integers: lo..hi holds what `code` can give, which may leave the type (not yet wrapped)."""

    code: str
    type: Type
    lo: int = 0
    hi: int = 0
    const: bool | int | float | None = None
    simple: bool = False  # may be repeated: a name or a number


def constant(kind: Type, value: bool | int | float) -> Value:
    """A value known now."""
    bound = int(value) if not isinstance(value, float) else 0
    code = repr(value) if isinstance(value, bool) or value >= 0 else f"({value!r})"
    return Value(code, kind, bound, bound, value, simple=True)


def ranged(code: str, kind: Type, *, simple: bool = False) -> Value:
    """A value that may be anything its type can hold."""
    plain = kind.base if isinstance(kind, Enum) else kind
    if isinstance(plain, Elementary):
        return Value(code, kind, plain.lo, plain.hi, simple=simple)
    return Value(code, kind, simple=simple)


def settled(value: Value) -> Value:
    """Wrapped to its type."""
    kind = value.type
    if not isinstance(kind, Elementary) or not kind.is_integer or kind is ANY_INT:
        return value
    if kind.lo <= value.lo and value.hi <= kind.hi:
        return value
    if value.const is not None:
        return constant(kind, wrapped(int(value.const), kind))
    if kind.kind != "sint":
        return ranged(f"({value.code} & {kind.hi})", kind)
    code = f"(_w if {kind.lo} <= (_w := {value.code}) <= {kind.hi} else _st_wrap(_w, {kind.bits}))"
    return ranged(code, kind)


def exact(value: Value) -> Value:
    """For who must not see a wrap: runtimes compute intermediates of less than 64 bits with different widths."""
    kind = value.type
    if not isinstance(kind, Elementary) or not kind.is_integer or kind is ANY_INT or kind.size == 8:
        return settled(value)
    if kind.lo <= value.lo and value.hi <= kind.hi:
        return value
    code = f"(_w if {kind.lo} <= (_w := {value.code}) <= {kind.hi} else _st_over(_w, {kind.name!r}))"
    return ranged(code, kind)


def wrapped(number: int, kind: Elementary) -> int:
    """A known number, wrapped."""
    return st_runtime.wrap_signed(number, kind.bits) if kind.kind == "sint" else number & kind.hi


def _smallest(number: int) -> Elementary:
    names = ("SINT", "INT", "DINT", "LINT") if number < 0 else ("USINT", "UINT", "UDINT", "ULINT")
    for name in names:
        if ELEMENTARY[name].lo <= number <= ELEMENTARY[name].hi:
            return ELEMENTARY[name]
    raise MismatchError(f"{number} fits no integer type")


def _literal_as(value: Value, other: Type) -> Value:
    """A literal in the type of what it meets."""
    number = value.const
    if number is None or not isinstance(other, Elementary) or isinstance(number, bool):
        return value
    if value.type is ANY_INT and other.is_real:
        return constant(other if other.kind == "real" else LREAL, float(number))
    if value.type is ANY_INT and other.is_integer and other is not ANY_INT:
        fit = other.lo <= number <= other.hi
        return constant(other if fit else _smallest(int(number)), int(number))
    if value.type is ANY_REAL and other is REAL:
        if st_runtime.float32(float(number)) != number:
            raise MismatchError(f"{number} is not exact as REAL, compilers differ: convert the REAL with TO_LREAL")
        return constant(REAL, float(number))
    if value.type is ANY_REAL and other is LREAL:
        return constant(LREAL, float(number))
    return value


def paired(a: Value, b: Value, op: str) -> tuple[Value, Value, Elementary]:
    """Both operands in their common elementary type, not wrapped yet."""
    a, b = _literal_as(a, b.type), _literal_as(b, a.type)
    if a.type in (ANY_INT, ANY_REAL) and b.type in (ANY_INT, ANY_REAL):
        kind: Type | None = ANY_INT if a.type is b.type is ANY_INT else ANY_REAL
    else:
        kind = common(a.type, b.type)
    if not isinstance(kind, Elementary):
        raise MismatchError(f"{a.type.name} {op} {b.type.name}: no common type, convert one of them")
    return _widened(a, kind), _widened(b, kind), kind


def _widened(value: Value, kind: Elementary) -> Value:
    if value.type is kind:
        return value
    value = exact(value)
    if value.const is not None:
        return constant(kind, float(value.const) if kind.is_real else value.const)
    if kind.is_real and isinstance(value.type, Elementary) and value.type.is_integer:
        return Value(f"_st_float({value.code})", kind)
    return Value(value.code, kind, value.lo, value.hi, simple=value.simple)


_FOLD: dict[str, Callable[[int, int], int]] = {"+": operator.add, "-": operator.sub, "*": operator.mul}
_FOLD |= {"/": st_runtime.divide, "MOD": st_runtime.modulo}


def arithmetic(op: str, a: Value, b: Value) -> Value:
    """+ - * / MOD."""
    a, b, kind = paired(a, b, op)
    if kind.is_real:
        return _real_arithmetic(op, a, b, kind)
    if not kind.is_integer:
        raise MismatchError(f"{kind.name} {op} {kind.name}: not a number")
    if op in ("/", "MOD"):
        return _division(op, exact(a), exact(b), kind)
    found = _FOLD[op]
    if a.const is not None and b.const is not None:
        return settled(constant(kind, found(int(a.const), int(b.const))))
    corners = [found(x, y) for x in (a.lo, a.hi) for y in (b.lo, b.hi)]
    result = Value(f"({a.code} {op} {b.code})", kind, min(corners), max(corners))
    if max(-result.lo, result.hi) >> 128:  # do not let numbers grow without bound
        a, b = settled(a), settled(b)
        corners = [found(x, y) for x in (a.lo, a.hi) for y in (b.lo, b.hi)]
        return settled(Value(f"({a.code} {op} {b.code})", kind, min(corners), max(corners)))
    return result


def _real_arithmetic(op: str, a: Value, b: Value, kind: Elementary) -> Value:
    if op == "MOD":
        raise MismatchError("MOD of a real")
    if a.const is not None and b.const is not None:
        x, y = float(a.const), float(b.const)
        if op == "/" and y == 0.0:
            raise MismatchError("division by zero")
        number = {"+": x + y, "-": x - y, "*": x * y}[op] if op != "/" else x / y
        return constant(kind, st_runtime.float32(number) if kind is REAL else number)
    code = f"({a.code} {op} {b.code})"
    return Value(f"_st_f32{code}" if kind is REAL else code, kind)


def _division(op: str, a: Value, b: Value, kind: Elementary) -> Value:
    if b.const == 0:
        raise MismatchError("division by zero")
    if a.const is not None and b.const is not None:
        return constant(kind, _FOLD[op](int(a.const), int(b.const)))
    if a.lo >= 0 and b.lo >= 0:
        hi = a.hi // max(b.lo, 1) if op == "/" else min(a.hi, b.hi - 1)
        return Value(f"({a.code} {'//' if op == '/' else '%'} {b.code})", kind, 0, hi)
    reach = max(abs(a.lo), abs(a.hi)) if op == "/" else min(max(-a.lo, a.hi), max(-b.lo, b.hi) - 1)
    return Value(f"_st_{'div' if op == '/' else 'mod'}({a.code}, {b.code})", kind, min(0, -reach), reach)


_BITS = {"AND": "&", "OR": "|", "XOR": "^"}
_BIT_FOLD: dict[str, Callable[[int, int], int]] = {"AND": operator.and_, "OR": operator.or_, "XOR": operator.xor}


def logic(op: str, a: Value, b: Value) -> Value:
    """AND OR XOR of BOOLs (both sides are evaluated) or bit by bit; AND_THEN, OR_ELSE of BOOLs."""
    if a.type is BOOL and b.type is BOOL:
        if a.const is not None and b.const is not None and op in _BIT_FOLD:
            return constant(BOOL, bool(_BIT_FOLD[op](bool(a.const), bool(b.const))))
        word = {"AND_THEN": "and", "OR_ELSE": "or"}.get(op) or _BITS[op]
        return Value(f"({a.code} {word} {b.code})", BOOL)
    if op not in _BITS:
        raise MismatchError(f"{a.type.name} {op} {b.type.name}: BOOLs only")
    a, b, kind = paired(settled(a), settled(b), op)
    if not kind.is_integer:
        raise MismatchError(f"{a.type.name} {op} {b.type.name}: whole numbers or BOOLs only")
    if a.const is not None and b.const is not None:
        return constant(kind, _BIT_FOLD[op](int(a.const), int(b.const)))
    lo, hi = kind.lo, kind.hi
    if a.lo >= 0 and b.lo >= 0:
        lo, hi = 0, min(a.hi, b.hi) if op == "AND" else (1 << max(a.hi, b.hi).bit_length()) - 1
    return Value(f"({a.code} {_BITS[op]} {b.code})", kind, lo, hi)


def negated(op: str, value: Value) -> Value:
    """Unary - and NOT."""
    kind = value.type
    if op == "NOT":
        return _inverted(value)
    if not isinstance(kind, Elementary) or not (kind.is_integer or kind.is_real) or kind.kind in ("uint", "bits"):
        raise MismatchError(f"- of {kind.name}")
    if value.const is not None:
        return settled(constant(kind, -value.const))
    return Value(f"(-{value.code})", kind, -value.hi, -value.lo)


def _inverted(value: Value) -> Value:
    value, kind = settled(value), value.type
    if kind is BOOL:
        return constant(BOOL, not value.const) if value.const is not None else Value(f"(not {value.code})", BOOL)
    if not isinstance(kind, Elementary) or not kind.is_integer or kind is ANY_INT:
        raise MismatchError(f"NOT of {kind.name}")
    if value.const is not None:
        return constant(kind, wrapped(~int(value.const), kind))
    return ranged(f"(~{value.code})" if kind.kind == "sint" else f"({value.code} ^ {kind.hi})", kind)


_COMPARE: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "=": ("==", operator.eq),
    "<>": ("!=", operator.ne),
    "<": ("<", operator.lt),
    "<=": ("<=", operator.le),
    ">": (">", operator.gt),
    ">=": (">=", operator.ge),
}


def compared(op: str, a: Value, b: Value) -> Value:
    """= <> < <= > >= of numbers; = <> of BOOLs, enums and pointers."""
    word, found = _COMPARE[op]
    a, b = exact(a), exact(b)
    if isinstance(a.type, Enum) or isinstance(b.type, Enum):
        a, b = _compared_enums(a, b)
    elif isinstance(a.type, Pointer) or isinstance(b.type, Pointer):
        a, b = _compared_pointers(op, a, b)
    else:
        a, b, kind = paired(a, b, op)
        if kind is BOOL and op not in ("=", "<>"):
            raise MismatchError(f"BOOL {op} BOOL")
    if a.const is not None and b.const is not None:
        return constant(BOOL, found(a.const, b.const))
    return Value(f"({a.code} {word} {b.code})", BOOL)


def _compared_enums(a: Value, b: Value) -> tuple[Value, Value]:
    for enum, other in ((a, b), (b, a)):
        if isinstance(enum.type, Enum) and (other.type is enum.type or other.type is enum.type.base):
            return a, b
    raise MismatchError(f"{a.type.name} compared with {b.type.name}")


def _compared_pointers(op: str, a: Value, b: Value) -> tuple[Value, Value]:
    if op not in ("=", "<>") or b.const != 0:
        raise MismatchError(f"{a.type.name} {op} {b.type.name}: a pointer is compared with 0 only")
    return a, Value("None", b.type)


def converted(value: Value, target: Type, what: str) -> Value:
    """For an assignment: implicit conversions only."""
    if value.type is target:
        return settled(value)
    if value.type in (ANY_INT, ANY_REAL) and isinstance(target, Elementary):
        return _literal_assigned(value, target, what)
    if isinstance(target, Pointer) and value.const == 0 and value.type is ANY_INT:
        return Value("None", target)
    if not fits(value.type, target):
        raise MismatchError(f"{what}: {value.type.name} does not become {target.name} without a conversion")
    if isinstance(target, Elementary):
        return _widened(value, target)
    return settled(value)


def _literal_assigned(value: Value, target: Elementary, what: str) -> Value:
    number = value.const
    if number is None or target is BOOL or (value.type is ANY_REAL and not target.is_real):
        raise MismatchError(f"{what}: {value.type.name} does not become {target.name} without a conversion")
    if target.is_real:
        return constant(target, st_runtime.float32(float(number)) if target is REAL else float(number))
    if not target.lo <= number <= target.hi:
        raise MismatchError(f"{what}: {number} does not fit {target.name}")
    return constant(target, int(number))


def cast(value: Value, target: Elementary) -> Value:
    """TO_X and X_TO_Y."""
    source = value.type.base if isinstance(value.type, Enum) else value.type
    if not isinstance(source, Elementary):
        raise MismatchError(f"TO_{target.name} of {source.name}")
    value = settled(value) if target.is_integer and target.size <= source.size else exact(value)
    if target is BOOL:
        if source is BOOL:
            return value
        return constant(BOOL, value.const != 0) if value.const is not None else Value(f"({value.code} != 0)", BOOL)
    if target.is_real:
        return _cast_to_real(value, source, target)
    if source.is_real:
        return ranged(f"_st_int({value.code}, {target.lo}, {target.hi})", target)
    if source is BOOL:
        return (
            constant(target, int(value.const)) if value.const is not None else Value(f"(+{value.code})", target, 0, 1)
        )
    if value.const is not None:
        return constant(target, wrapped(int(value.const), target))
    return settled(Value(value.code, target, value.lo, value.hi, simple=value.simple))


def _cast_to_real(value: Value, source: Elementary, target: Elementary) -> Value:
    if value.const is not None:
        number = float(value.const)
        return constant(target, st_runtime.float32(number) if target is REAL else number)
    code = value.code if source.is_real else f"_st_float({value.code})"
    return Value(f"_st_f32({code})" if target is REAL and source is not REAL else code, target)
