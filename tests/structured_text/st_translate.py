"""From the syntax trees to one Python module: classes, constants, and a function for every body."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import st_ast as ast
from st_emitter import Emitter, Line
from st_errors import StTypeError
from st_memory import union_class, view_class
from st_model import Model, Scope
from st_runtime import NAMES
from st_statements import Statements
from st_types import Array, Elementary, Enum, FunctionBlock, Pointer, Record, Signature, Type, Variable, python_name
from st_values import Value

FILE_NAME = "<structured text>"
_LOCAL = ("VAR", "VAR_TEMP", "VAR_OUTPUT")
_KNOWN = (*_LOCAL, "VAR_INPUT", "VAR_IN_OUT")


@dataclass(frozen=True, slots=True)
class Translation:
    """The Python source of all POUs, and what each of its lines came from."""

    model: Model
    source: str
    lines: list[Line]
    marks: list[str]  # where statements begin, if they are counted
    errors: list[StTypeError]


def constant_value(expression: ast.Expression, scope: Scope) -> Value:
    """A constant expression, for the model."""
    return Statements(scope, Emitter(), "").value(expression)


class Translator:
    """Writes the module; with `count` statements leave marks. Type errors are collected, one a statement at most."""

    def __init__(self, model: Model, count: bool = False) -> None:
        self.model, self.out = model, Emitter(count)
        self._found: list[StTypeError] = []

    def run(self) -> Translation:
        """All of it."""
        for name in self.model.type_names():
            self._guarded(self._record, name)
        for name in self.model.pous:
            self._guarded(self._class, name)
        for lower, scope in self.model.global_scopes.items():
            self._guarded(self._globals, self.model.global_names[lower], scope)
        for pou in self.model.pous.values():
            self._guarded(self._pou, pou)
            for method in pou.methods:
                self._guarded(self._method, pou, method)
        errors = list({str(error): error for error in self._found}.values())
        return Translation(self.model, self.out.source(), self.out.lines, self.out.marks, errors)

    def _guarded(self, work: Callable[..., None], *given: Any) -> None:
        indent = self.out.indent
        try:
            work(*given)
        except StTypeError as error:
            self.out.indent = indent
            self._found.append(error)

    def _statements(self, scope: Scope, part: str, result: str = "") -> Statements:
        scope.part = self.model.part(scope.label, part)
        self.out.label = f"{scope.label} {scope.part}"
        return Statements(scope, self.out, result, self._found)

    def _record(self, name: str) -> None:
        record = self.model.named_type(name)
        if not isinstance(record, Record):
            return
        scope = Scope(self.model, record.name, "")
        if record.is_union:
            self._check_layout(record, scope)
            return
        fields = [(python_name(member.name), member) for member in record.fields.values()]
        self._class_head(f"_g_{record.name}", [name for name, _ in fields])
        with self.out.deeper():
            self._init(scope, fields)
            self._setter(fields)
        self.out.emit("", 0)

    def _check_layout(self, record: Record, scope: Scope) -> None:
        try:
            union_class(record)
            for inner in records_within(record):
                view_class(inner)
        except (ValueError, TypeError) as error:
            scope.fail(1, f"{record.name}: {error}")

    def _class_head(self, code: str, names: Iterable[str]) -> None:
        self.out.emit(f"class {code}:", 0)
        with self.out.deeper():
            self.out.emit(f"__slots__ = ({''.join(f'{name!r}, ' for name in names)})", 0)

    def _init(self, scope: Scope, fields: list[tuple[str, Variable]]) -> None:
        maker = self._statements(scope, "declaration ")
        self.out.emit("def __init__(self):", 0)
        with self.out.deeper():
            self.out.emit("pass", 0)
            for name, member in fields:
                is_reference = member.kind == "VAR_IN_OUT"
                code = "None" if is_reference else maker.default(member.type, member.initial, member.name)
                self.out.emit(f"self.{name} = {code}", member.line)

    def _setter(self, fields: list[tuple[str, Variable]]) -> None:
        self.out.emit("def st_set(self, other):", 0)
        with self.out.deeper():
            self.out.emit("pass", 0)
            for name, member in fields:
                self.out.emit(_field_copy(name, member.type), 0)
        self.out.emit("def st_from(self, other):", 0)
        with self.out.deeper():
            self.out.emit("self.st_set(other)", 0)
            self.out.emit("return self", 0)

    def _class(self, name: str) -> None:
        scope = self.model.pou_scope(name)
        for variable in scope.variables():
            if variable.kind not in _KNOWN:
                scope.fail(variable.line, f"{variable.kind} is not in the dialect")
        self._constants(scope)
        block = self.model.types.get(name)
        if not isinstance(block, FunctionBlock):
            return
        fields = [(python_name(v.name), v) for v in block.variables.values() if not v.constant]
        self._class_head(block.code, [name for name, _ in fields])
        with self.out.deeper():
            self._init(scope, fields)

    def _constants(self, scope: Scope) -> None:
        maker = self._statements(scope, "declaration ")
        for variable in scope.variables():
            if variable.constant and variable.const is None:
                self.out.emit(
                    f"{variable.code} = {maker.default(variable.type, variable.initial, variable.name)}", variable.line
                )

    def _globals(self, name: str, scope: Scope) -> None:
        self._constants(scope)
        fields = [(python_name(v.name), v) for v in scope.variables() if not v.constant]
        self._class_head(f"_g_{name}", [name for name, _ in fields])
        with self.out.deeper():
            self._init(scope, fields)
        self.out.emit(f"_v_{name} = _g_{name}()", 0)

    def _pou(self, pou: ast.Pou) -> None:
        scope = self.model.pou_scope(pou.name)
        if pou.kind == "FUNCTION":
            signature = self.model.function(pou.name)
            if signature:
                self._function(scope, signature, [], pou.body)
            return
        self.out.label = pou.name
        self.out.emit(f"def _g_{pou.name}__body_(self):", pou.line)
        with self.out.deeper():
            self._statements(scope, "implementation ", "return").body(pou.body)

    def _method(self, pou: ast.Pou, method: ast.Method) -> None:
        scope = self.model.method_scope(pou, method)
        block = self.model.types[pou.name.lower()]
        if isinstance(block, FunctionBlock):
            for variable in scope.variables():
                if variable.kind not in _KNOWN:
                    scope.fail(variable.line, f"{variable.kind} is not in the dialect")
            self._constants(scope)
            self._function(scope, block.methods[method.name.lower()], ["self"], method.body)

    def _function(self, scope: Scope, signature: Signature, head: list[str], body: tuple[ast.Statement, ...]) -> None:
        names = head + [parameter.code for parameter in signature.parameters]
        maker = self._statements(scope, "declaration ")
        result = python_name(signature.label.split(".")[-1])
        back = ([result] if signature.result else []) + [variable.code for variable in signature.returned]
        text = f"return {', '.join(back)}"
        if signature.returned and len(back) == 1:
            text += ","  # one output alone is still unpacked
        self.out.emit(f"def {signature.code}({', '.join(names)}):", 0)
        with self.out.deeper():
            if signature.result:
                self.out.emit(f"{result} = {maker.default(signature.result, None, result)}", 0)
            for variable in scope.variables(*_LOCAL):
                if not variable.constant:
                    code = maker.default(variable.type, variable.initial, variable.name)
                    self.out.emit(f"{variable.code} = {code}", variable.line)
            self._statements(scope, "implementation ", text).body(body)
            self.out.emit(text, 0)


def _field_copy(name: str, kind: Type) -> str:
    if isinstance(kind, Elementary | Enum | Pointer):
        return f"self.{name} = other.{name}"
    if isinstance(kind, Array) and isinstance(kind.element, Elementary | Enum):
        return f"self.{name}[:] = other.{name}"
    if isinstance(kind, Array):
        return f"_st_items(self.{name}, other.{name})"
    return f"self.{name}.st_set(other.{name})"


def records_within(kind: Type) -> list[Record]:
    """Structs inside a union, itself left out."""
    if isinstance(kind, Array):
        return records_within(kind.element) + ([kind.element] if isinstance(kind.element, Record) else [])
    if not isinstance(kind, Record):
        return []
    found = []
    for member in kind.fields.values():
        found += records_within(member.type)
        if isinstance(member.type, Record):
            found.append(member.type)
    return found


def namespace(model: Model) -> dict[str, Any]:
    """What the module needs before it is executed: run-time functions, unions, views."""
    found: dict[str, Any] = {**NAMES, **model.kept}
    for name in model.type_names():
        record = model.named_type(name)
        if isinstance(record, Record) and record.is_union:
            found[f"_g_{record.name}"] = union_class(record)
            for inner in records_within(record):
                found[f"_view_{inner.name}"] = view_class(inner)
    return found
