"""The functions that every PLC has: conversions, MIN, SHL, ADR, SIZEOF, MEMCPY and their like."""

import re

import st_ast as ast
from st_defaults import Defaults
from st_expressions import Location
from st_types import (
    ANY_INT,
    BYTE,
    ELEMENTARY,
    LREAL,
    UDINT,
    USINT,
    Array,
    Elementary,
    Enum,
    FunctionBlock,
    Pointer,
    Record,
    Type,
    fits,
    size_of,
)
from st_values import Value, cast, constant, exact, paired, ranged, settled

_CONVERSION = re.compile(r"(?:([A-Z]+)_)?TO_([A-Z]+)$")
_BYTES = Pointer(BYTE)


class Builtins(Defaults):
    """Calls of built-in functions."""

    def builtin(self, name: str, call: ast.Call) -> Value | None:
        """The value of a built-in function's call; None: there is no such function."""
        match = _CONVERSION.match(name)
        if match and match[2] in ELEMENTARY and (not match[1] or match[1] in ELEMENTARY):
            return self._conversion(match[1], ELEMENTARY[match[2]], call)
        found = {
            "ABS": self._abs,
            "MIN": self._extreme,
            "MAX": self._extreme,
            "LIMIT": self._limit,
            "SQRT": self._sqrt,
            "SHL": self._shift,
            "SHR": self._shift,
            "ROL": self._rotate,
            "ROR": self._rotate,
            "ADR": self._adr,
            "SIZEOF": self._sizeof,
            "MEMCPY": self._memory,
            "MEMSET": self._memory,
        }.get(name)
        return found(name, call) if found else None

    def _positional(self, name: str, call: ast.Call, *counts: int) -> list[ast.Expression]:
        found = [a.value for a in call.arguments if a.value is not None and not a.name]
        if len(found) != len(call.arguments) or (counts and len(found) not in counts):
            self.fail(call.line, f"{name} takes {' or '.join(map(str, counts))} arguments without names")
        return found

    def _conversion(self, source: str | None, target: Elementary, call: ast.Call) -> Value:
        name = f"{source + '_' if source else ''}TO_{target.name}"
        (expression,) = self._positional(name, call, 1)
        value = self.value(expression)
        if source:
            value = self.convert(value, ELEMENTARY[source], name, call.line)
        return cast(value, target)

    def _abs(self, name: str, call: ast.Call) -> Value:
        (expression,) = self._positional(name, call, 1)
        value = exact(self.value(expression))
        kind = value.type
        if not isinstance(kind, Elementary) or not (kind.is_integer or kind.is_real):
            return self.fail(call.line, f"ABS of {kind.name}")
        if value.const is not None:
            return constant(kind, abs(value.const))
        lo = 0 if value.lo <= 0 <= value.hi else min(abs(value.lo), abs(value.hi))
        return Value(f"_st_abs({value.code})", kind, lo, max(abs(value.lo), abs(value.hi)))

    def _extreme(self, name: str, call: ast.Call) -> Value:
        values = [self.value(expression) for expression in self._positional(name, call)]
        if len(values) < 2:
            self.fail(call.line, f"{name} takes two arguments or more")
        found = values[0]
        for value in values[1:]:
            found = self._extreme_of_two(name, found, value)
        return found

    def _extreme_of_two(self, name: str, a: Value, b: Value) -> Value:
        a, b, kind = paired(exact(a), exact(b), name)
        pick = min if name == "MIN" else max
        if a.const is not None and b.const is not None:
            return constant(kind, pick(a.const, b.const))
        code = f"_st_{name.lower()}({a.code}, {b.code})"
        if a.simple and b.simple:
            code = f"({b.code} if {b.code} {'<' if name == 'MIN' else '>'} {a.code} else {a.code})"
        return Value(code, kind, pick(a.lo, b.lo), pick(a.hi, b.hi))

    def _limit(self, name: str, call: ast.Call) -> Value:
        low, value, high = (self.value(expression) for expression in self._positional(name, call, 3))
        return self._extreme_of_two("MIN", self._extreme_of_two("MAX", value, low), high)

    def _sqrt(self, name: str, call: ast.Call) -> Value:
        (expression,) = self._positional(name, call, 1)
        value = self.convert(self.value(expression), LREAL, name, call.line)
        return Value(f"_st_sqrt({value.code})", LREAL)

    def _shift_operands(self, name: str, call: ast.Call) -> tuple[Value, Value, Elementary]:
        first, second = self._positional(name, call, 2)
        value, count = self.value(first), exact(self.value(second))
        value = settled(value) if name == "SHL" else exact(value)
        kind = value.type
        if not isinstance(kind, Elementary) or kind.kind not in ("bits", "uint"):
            return self.fail(call.line, f"{name} of {kind.name}: its width is not known; say UDINT#... or convert")
        if not isinstance(count.type, Elementary) or not count.type.is_integer:
            return self.fail(call.line, f"{name} by {count.type.name}")
        if count.const is not None and not 0 <= count.const < kind.bits:
            return self.fail(call.line, f"{name} by {count.const} of {kind.bits} bits")
        if count.lo < 0 or count.hi >= kind.bits:
            count = Value(f"_st_shift({count.code}, {kind.bits})", count.type, 0, kind.bits - 1)
        return value, count, kind

    def _shift(self, name: str, call: ast.Call) -> Value:
        value, count, kind = self._shift_operands(name, call)
        if value.const is not None and count.const is not None:
            number, by = int(value.const), int(count.const)
            return constant(kind, (number << by) & kind.hi if name == "SHL" else number >> by)
        if name == "SHR":
            return Value(f"({value.code} >> {count.code})", kind, 0, value.hi >> count.lo)
        return settled(Value(f"({value.code} << {count.code})", kind, 0, value.hi << count.hi))

    def _rotate(self, name: str, call: ast.Call) -> Value:
        value, count, kind = self._shift_operands(name, call)
        there, back = ("<<", ">>") if name == "ROL" else (">>", "<<")
        name = value.code if value.simple else self.out.temporary()
        first, again = value.code if value.simple else f"({name} := {value.code})", name
        by, rest = count.code, f"{kind.bits} - {count.code}"
        if count.const is not None:
            rest = str(kind.bits - int(count.const))
        elif not count.simple:
            name = self.out.temporary()
            by, rest = f"({name} := {count.code})", f"{kind.bits} - {name}"
        return ranged(f"(({first} {there} {by} | {again} {back} ({rest})) & {kind.hi})", kind)

    def _sizeof(self, name: str, call: ast.Call) -> Value:
        (expression,) = self._positional(name, call, 1)
        kind: Type | None = None
        if isinstance(expression, ast.Name) and self.scope.find(expression.text) is None:
            kind = self.model.named_type(expression.text)
            if kind is None:
                return self.fail(call.line, f"unknown name {expression.text}")
        kind = kind or self.location(expression).type
        if isinstance(kind, FunctionBlock | Pointer):
            return self.fail(call.line, f"SIZEOF {kind.name}: differs between runtimes")
        return constant(ANY_INT, size_of(kind))

    def _adr(self, name: str, call: ast.Call) -> Value:
        (expression,) = self._positional(name, call, 1)
        if isinstance(expression, ast.Index) and len(expression.indices) == 1:
            found = self._adr_of_byte(expression)
            if found:
                return found
        place = self.location(expression)
        return Value(f"_st_Place({self._bytes_of(place, call.line)})", _BYTES)

    def _adr_of_byte(self, node: ast.Index) -> Value | None:
        base = self.location(node.base)
        index = exact(self.value(node.indices[0]))
        if isinstance(base.type, Pointer):
            return Value(f"_st_Place({base.code}.buf, {base.code}.at + {index.code})", _BYTES)
        if base.owner or not isinstance(base.type, Array) or base.type.element not in (BYTE, USINT):
            return None
        return Value(f"_st_Place({base.code}, {self._checked(index, base.type, both=True, line=node.line)})", _BYTES)

    def _bytes_of(self, place: Location, line: int) -> str:
        kind = place.type
        if place.owner:
            return f"{place.owner}.st_B, {place.slot(1)}"
        if isinstance(kind, Record) and kind.is_union:
            return f"{place.code}.st_B, 0"
        if isinstance(kind, Array) and kind.element in (BYTE, USINT):
            return f"{place.code}, 0"
        if isinstance(kind, Array | Record):
            return f'_st_Cell({place.code}, "", {self.kept(kind)}), 0'
        owner, _, attribute = place.code.rpartition(".")
        if isinstance(kind, Elementary | Enum) and owner and attribute.isidentifier():
            return f'_st_Cell({owner}, "{attribute}", {self.kept(kind)}), 0'
        return self.fail(line, f"ADR of this {kind.name}: put it into a union or an array of BYTE")

    def _memory(self, name: str, call: ast.Call) -> Value:
        wanted = ["destAddr", "srcAddr" if name == "MEMCPY" else "fillByte", "n"]
        given = {a.name.lower(): a.value for a in call.arguments}
        if set(given) == {""}:
            found = self._positional(name, call, 3)
        elif set(given) == {word.lower() for word in wanted} and len(call.arguments) == 3:
            found = [value for word in wanted if (value := given[word.lower()]) is not None]
        else:
            return self.fail(call.line, f"{name} takes {', '.join(wanted)}")
        second: Type = _BYTES if name == "MEMCPY" else BYTE
        kinds = (_BYTES, second, UDINT)
        codes = [
            self._narrowed(self.value(e), kind, f"{name} {word}", call.line)
            for e, kind, word in zip(found, kinds, wanted, strict=True)
        ]
        return Value(f"_st_{name.lower()}({', '.join(codes)})", UDINT)

    def _narrowed(self, value: Value, kind: Type, what: str, line: int) -> str:
        if kind is UDINT and isinstance(value.type, Elementary) and fits(value.type, ELEMENTARY["ULINT"]):
            return exact(value).code
        return self.convert(value, kind, what, line).code
