"""Expressions: names, members, indices, operators; reading from plain objects and from unions."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import st_ast as ast
from st_errors import StTypeError
from st_model import Scope, is_visible
from st_types import (
    ANY_INT,
    ANY_REAL,
    BOOL,
    BYTE,
    ELEMENTARY,
    USINT,
    Array,
    Elementary,
    Enum,
    FunctionBlock,
    Pointer,
    Record,
    Type,
    Variable,
    offset_of,
    size_of,
)
from st_values import MismatchError, Value, arithmetic, compared, constant, exact, logic, negated, ranged


@dataclass(frozen=True, slots=True)
class Location:
    """Where a value lies: plain Python `code`, or in the memory of the union `owner` at offset + sum of terms."""

    type: Type
    code: str = ""
    owner: str = ""
    offset: int = 0
    terms: tuple[tuple[str, int], ...] = ()  # index code, stride in bytes
    blocked: str = ""  # why it may not be written
    variable: Variable | None = None
    parameter: bool = False  # an in-out: may lie in a union, seen through a view

    def slot(self, size: int) -> str:
        """The place in units of `size` bytes, as Python source."""
        parts = [code if stride == size else f"{code} * {stride // size}" for code, stride in self.terms]
        if self.offset or not parts:
            parts.append(str(self.offset // size))
        return " + ".join(parts)


@dataclass(slots=True)
class Ranges:
    """What is known of local variables at this point: loop variables that the body leaves alone."""

    known: dict[str, tuple[int, int]] = field(default_factory=dict)


class Expressions:
    """Translates expressions in one scope. Subclasses add calls and statements."""

    def __init__(self, scope: Scope) -> None:
        self.scope, self.model = scope, scope.model
        self.ranges = Ranges()

    def fail(self, line: int, text: str) -> Any:
        """A type error at a line."""
        self.scope.fail(line, text)

    def value(self, expression: ast.Expression) -> Value:
        """An expression as a typed piece of Python source."""
        try:
            return self._value(expression)
        except MismatchError as error:
            raise self._located(expression.line, error) from error

    def _located(self, line: int, error: MismatchError) -> StTypeError:
        try:
            self.scope.fail(line, str(error))
        except StTypeError as located:
            return located

    def _value(self, expression: ast.Expression) -> Value:
        if isinstance(expression, ast.Literal):
            return self._literal(expression)
        if isinstance(expression, ast.Binary):
            return self._binary(expression)
        if isinstance(expression, ast.Unary):
            return negated(expression.op, self.value(expression.operand))
        if isinstance(expression, ast.Call):
            return self.call_value(expression)
        known = self._known(expression)
        return known if known else self.load(self.location(expression), expression.line)

    def call_value(self, call: ast.Call) -> Value:
        """A call's result; the calls are in a subclass."""
        return self.fail(call.line, "no calls here")

    def _literal(self, literal: ast.Literal) -> Value:
        value, name = literal.value, literal.type_name
        if isinstance(value, str):
            return self.fail(literal.line, f"{name} literals are not in the dialect")
        if not name:
            return constant(ANY_REAL if isinstance(value, float) else ANY_INT, value)
        kind = ELEMENTARY.get(name)
        if kind is None or isinstance(value, bool) != (kind is BOOL):
            return self.fail(literal.line, f"{name}#{value}")
        if kind.is_real:
            return constant(kind, float(value))
        if isinstance(value, float) or not kind.lo <= value <= kind.hi:
            return self.fail(literal.line, f"{name}#{value} does not fit")
        return constant(kind, value)

    def _binary(self, node: ast.Binary) -> Value:
        a = self.value(node.left)
        if node.op in ("AND_THEN", "OR_ELSE"):
            return self.short_circuit(node, a)
        b = self.value(node.right)
        if node.op in ("AND", "OR", "XOR"):
            return logic(node.op, a, b)
        if node.op in ("+", "-", "*", "/", "MOD"):
            return arithmetic(node.op, a, b)
        return compared(node.op, a, b)

    def short_circuit(self, node: ast.Binary, left: Value) -> Value:
        """AND_THEN, OR_ELSE."""
        return logic(node.op, left, self.value(node.right))

    def _known(self, expression: ast.Expression) -> Value | None:
        """Constants: an enum's item, or a constant of numbers."""
        if isinstance(expression, ast.Member) and isinstance(expression.base, ast.Name):
            owner = expression.base.text
            if self.scope.find(owner) is None and owner.lower() not in self.model.global_scopes:
                kind = self.model.named_type(owner)
                if isinstance(kind, Enum):
                    item = kind.items.get(expression.name.lower())
                    return (
                        constant(kind, item[1]) if item else self.fail(expression.line, f"no {owner}.{expression.name}")
                    )
        return None

    def load(self, place: Location, line: int) -> Value:
        """Read; a real from a union is looked at first, because NaN can stop a runtime."""
        kind, variable = place.type, place.variable
        if variable is not None and variable.const is not None:
            return constant(kind, variable.const)
        if not place.owner:
            if variable is not None and variable.code in self.ranges.known:
                return Value(place.code, kind, *self.ranges.known[variable.code], simple=True)
            return ranged(place.code, kind, simple=place.code.isidentifier())
        plain = kind.base if isinstance(kind, Enum) else kind
        if not isinstance(plain, Elementary):
            return Value(f"_st_finite({self.view(place)})", kind)
        code = self.memory_item(place, plain)
        if plain.is_real:
            return Value(f"(_f if (_f := {code}) - _f == 0.0 else _st_nan(_f))", kind)
        return ranged(code, kind)

    def memory_item(self, place: Location, kind: Elementary) -> str:
        """A number in a union's memory."""
        view = {"B": "st_B", "?": "st_bool"}.get(kind.code, f"st_{kind.code}")
        return f"{place.owner}.{view}[{place.slot(kind.size)}]"

    def view(self, place: Location) -> str:
        """A struct or array in a union's memory, for who wants an object; nothing is looked at."""
        kind = place.type
        if isinstance(kind, Record):
            return f"_view_{kind.name}({place.owner}, {place.slot(1)})"
        if isinstance(kind, Array) and isinstance(kind.element, Elementary):
            element = kind.element
            view = {"B": "st_V", "?": "st_bool"}.get(element.code, f"st_{element.code}")
            first = place.slot(element.size)
            if not place.terms:
                return f"{place.owner}.{view}[{first} : {int(first) + kind.count}]"
            return f"{place.owner}.{view}[(_s := {first}) : _s + {kind.count}]"
        return f"_st_Elements({place.owner}, {place.slot(1)}, {self.kept(kind)})"

    def kept(self, kind: Type) -> str:
        """A name by which the Python source has a type."""
        name = f"_t_{len(self.model.kept)}"
        self.model.kept[name] = kind
        return name

    def location(self, expression: ast.Expression) -> Location:
        """Where a variable, member, element or pointed-at byte lies."""
        found: dict[type, Callable[[Any], Location]] = {
            ast.Name: self._name,
            ast.Member: self._member,
            ast.Index: self._index,
            ast.Deref: self._deref,
        }
        if type(expression) not in found:
            return self.fail(expression.line, "not a variable")
        return found[type(expression)](expression)

    def _name(self, node: ast.Name) -> Location:
        variable = self.scope.find(node.text)
        if variable is None:
            return self.fail(node.line, f"unknown name {node.text}")
        blocked = f"{variable.name} is a constant" if variable.constant else ""
        return self._of_variable(variable, variable.code, blocked)

    def _of_variable(self, variable: Variable, code: str, blocked: str) -> Location:
        by_reference = variable.kind == "VAR_IN_OUT" and not isinstance(variable.type, FunctionBlock)
        return Location(variable.type, code, blocked=blocked, variable=variable, parameter=by_reference)

    def _member(self, node: ast.Member) -> Location:
        base = node.base
        if isinstance(base, ast.Deref) and isinstance(base.base, ast.Name) and base.base.text.upper() == "THIS":
            return self._this_member(node)
        if isinstance(base, ast.Name) and self.scope.find(base.text) is None:
            return self._global(base, node)
        place = self.location(base)
        if isinstance(place.type, FunctionBlock):
            return self._block_member(place, node)
        if not isinstance(place.type, Record):
            return self.fail(node.line, f"{place.type.name} has no members ({node.name})")
        member = place.type.fields.get(node.name.lower())
        if member is None:
            return self.fail(node.line, f"{place.type.name} has no member {node.name}")
        if place.type.is_union and not place.owner:
            return Location(member.type, owner=place.code, blocked=place.blocked, variable=None)
        if place.owner:
            return self._memory_member(place, place.type, member, node.line)
        return Location(member.type, f"{place.code}.{member.code}", blocked=place.blocked, parameter=place.parameter)

    def _memory_member(self, place: Location, record: Record, member: Variable, line: int) -> Location:
        try:
            offset = place.offset + (0 if record.is_union else offset_of(record, member.name.lower()))
        except ValueError as error:
            return self.fail(line, str(error))
        return replace(place, type=member.type, offset=offset)

    def _this_member(self, node: ast.Member) -> Location:
        block = self.scope.block
        variable = block.variables.get(node.name.lower()) if block else None
        if variable is None:
            return self.fail(node.line, f"THIS^ has no {node.name}")
        blocked = f"{variable.name} is a constant" if variable.constant else ""
        return self._of_variable(variable, variable.code, blocked)

    def _global(self, base: ast.Name, node: ast.Member) -> Location:
        scope = self.model.global_scopes.get(base.text.lower())
        if scope is None:
            return self.fail(node.line, f"unknown name {base.text}")
        variable = scope.own(node.name)
        if variable is None:
            return self.fail(node.line, f"{base.text} has no {node.name}")
        blocked = f"{base.text}.{variable.name} is a constant" if variable.constant else ""
        return self._of_variable(variable, variable.code, blocked)

    def _block_member(self, place: Location, node: ast.Member) -> Location:
        block = place.type
        variable = block.variables.get(node.name.lower()) if isinstance(block, FunctionBlock) else None
        if variable is None:
            return self.fail(node.line, f"{block.name} has no variable {node.name}")
        if not is_visible(variable):
            return self.fail(node.line, f"{block.name}.{variable.name} is local to {block.name}")
        blocked = "" if variable.kind == "VAR_INPUT" else f"{block.name}.{variable.name} is no input"
        return Location(variable.type, f"{place.code}.{variable.code.removeprefix('self.')}", blocked=blocked)

    def _index(self, node: ast.Index) -> Location:
        place = self.location(node.base)
        if isinstance(place.type, Pointer):
            return self._pointed(place, self._whole(node.indices[0]), node)
        for expression in node.indices:
            array = place.type
            if not isinstance(array, Array):
                return self.fail(node.line, f"{array.name} takes no index")
            place = self._element(place, array, self._whole(expression), node.line)
        return place

    def _whole(self, expression: ast.Expression) -> Value:
        value = exact(self.value(expression))
        if not isinstance(value.type, Elementary) or not value.type.is_integer:
            return self.fail(expression.line, f"an index is a whole number, not {value.type.name}")
        return value

    def _element(self, place: Location, array: Array, index: Value, line: int) -> Location:
        code = self._checked(index, array, both=bool(place.owner), line=line)
        if place.owner:
            size = size_of(array.element)
            if index.const is not None:
                return replace(place, type=array.element, offset=place.offset + int(code) * size)
            return replace(place, type=array.element, terms=(*place.terms, (code, size)))
        return Location(array.element, f"{place.code}[{code}]", blocked=place.blocked, parameter=place.parameter)

    def _checked(self, index: Value, array: Array, *, both: bool, line: int) -> str:
        """The index from 0 on, checked where it could leave the array and Python would not notice."""
        lower, upper = array.lower, array.upper
        if index.const is not None:
            if not lower <= index.const <= upper:
                self.fail(line, f"index {index.const} outside {lower}..{upper}")
            return str(int(index.const) - lower)
        code = index.code
        if index.lo < lower or (both and index.hi > upper):
            test, name = (code, code) if index.simple else (f"(_i := {code})", "_i")
            code = f"({name} if {lower} <= {test} <= {upper} else _st_oob({name}, {lower}, {upper}))"
        return f"({code} - {lower})" if lower else code

    def _deref(self, node: ast.Deref) -> Location:
        place = self.location(node.base)
        if not isinstance(place.type, Pointer):
            return self.fail(node.line, f"^ of {place.type.name}")
        return self._pointed(place, constant(ANY_INT, 0), node)

    def _pointed(self, place: Location, index: Value, node: ast.Index | ast.Deref) -> Location:
        target = place.type.target if isinstance(place.type, Pointer) else place.type
        if target not in (BYTE, USINT):
            return self.fail(node.line, f"{place.type.name} is not followed: only POINTER TO BYTE is")
        code = index.code
        if index.lo < 0:
            test, name = (code, code) if index.simple else (f"(_i := {code})", "_i")
            code = f"({name} if {test} >= 0 else _st_oob({name}, 0, {2**31}))"
        at = f"{place.code}.at" if index.const == 0 else f"{place.code}.at + {code}"
        return Location(target, f"{place.code}.buf[{at}]")
