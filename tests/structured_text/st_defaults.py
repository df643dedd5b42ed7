"""Initial values and copies as Python source."""

import st_ast as ast
from st_emitter import Emitter
from st_expressions import Expressions
from st_model import Scope
from st_types import (
    BOOL,
    Array,
    Elementary,
    Enum,
    FunctionBlock,
    Pointer,
    Record,
    Type,
    Variable,
    python_name,
)
from st_values import MismatchError, Value, converted


class Defaults(Expressions):
    """What a variable holds at first, and fresh copies of values."""

    def __init__(self, scope: Scope, emitter: Emitter) -> None:
        super().__init__(scope)
        self.out = emitter

    def default(self, kind: Type, initial: ast.Initial | None, what: str) -> str:
        """The initial value of a variable of this type."""
        if isinstance(initial, ast.ArrayInitial):
            return self._array(kind, initial, what)
        if isinstance(initial, ast.StructInitial):
            return self._struct(kind, initial, what)
        if initial is not None and isinstance(kind, Elementary | Enum | Pointer):
            return self.assigned_code(initial, kind, what)
        if initial is not None:
            return self.copied(self.value(initial), what, initial.line)
        return self._plain(kind)

    def _plain(self, kind: Type) -> str:
        if isinstance(kind, Elementary):
            return "0.0" if kind.is_real else "False" if kind is BOOL else "0"
        if isinstance(kind, Enum):
            return str(kind.default)
        if isinstance(kind, Array):
            element = self._plain(kind.element)
            flat = isinstance(kind.element, Elementary | Enum | Pointer)
            return f"[{element}] * {kind.count}" if flat else f"[{element} for _ in _st_range({kind.count})]"
        if isinstance(kind, Record):
            return f"_g_{kind.name}()"
        return f"{kind.code}()" if isinstance(kind, FunctionBlock) else "None"

    def assigned_code(self, expression: ast.Expression, kind: Type, what: str) -> str:
        """An expression converted to a type."""
        return self.convert(self.value(expression), kind, what, expression.line).code

    def convert(self, value: Value, kind: Type, what: str, line: int) -> Value:
        """A value converted to a type, as an assignment does."""
        try:
            return converted(value, kind, what)
        except MismatchError as error:
            raise self._located(line, error) from error

    def _array(self, kind: Type, initial: ast.ArrayInitial, what: str) -> str:
        if not isinstance(kind, Array):
            return self.fail(initial.line, f"{what}: {kind.name} is no array")
        items = [item for count, item in initial.items for _ in range(count)]
        if isinstance(kind.element, Array) and not any(isinstance(item, ast.ArrayInitial) for item in items):
            width = kind.element.count
            rows = [items[start : start + width] for start in range(0, len(items), width)]
            items = [ast.ArrayInitial(initial.line, tuple((1, item) for item in row)) for row in rows]
        if len(items) > kind.count:
            return self.fail(initial.line, f"{what}: {len(items)} values for {kind.count} elements")
        codes = [self.default(kind.element, item, what) for item in items]
        codes += [self._plain(kind.element)] * (kind.count - len(codes))
        return f"[{', '.join(codes)}]"

    def _struct(self, kind: Type, initial: ast.StructInitial, what: str) -> str:
        fields: dict[str, Variable] = {}
        if isinstance(kind, Record) and not kind.is_union:
            fields = kind.fields
        elif isinstance(kind, FunctionBlock):
            fields = {lower: v for lower, v in kind.variables.items() if v.kind == "VAR_INPUT"}
        codes = []
        for name, value in initial.fields:
            member = fields.get(name.lower())
            if member is None:
                return self.fail(initial.line, f"{what}: {kind.name} has no {name} to initialise")
            codes.append(f"{python_name(member.name)}={self.default(member.type, value, f'{what}.{name}')}")
        return f"_st_with({self._plain(kind)}, {', '.join(codes)})"

    def copied(self, value: Value, what: str, line: int) -> str:
        """A fresh copy of a value: what a VAR_INPUT gets."""
        kind = value.type
        if isinstance(kind, Record):
            return f"{self._plain(kind)}.st_from({value.code})"
        if isinstance(kind, Array) and isinstance(kind.element, Elementary | Enum):
            return f"_st_list({value.code})"
        if isinstance(kind, Array):
            return f"_st_filled({self._plain(kind)}, {value.code})"
        if isinstance(kind, FunctionBlock):
            return self.fail(line, f"{what}: a function block is not copied")
        return value.code
