"""What the sources declare: types, constants, variables and calls, each worked out when first asked for."""

from collections.abc import Callable, Iterable
from typing import NoReturn

import st_ast as ast
from st_errors import StTypeError
from st_names import named
from st_types import (
    ELEMENTARY,
    Array,
    Elementary,
    Enum,
    FunctionBlock,
    Pointer,
    Record,
    Signature,
    Type,
    Variable,
    python_name,
)
from st_values import MismatchError, Value, converted

_OUTSIDE = ("VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT")  # what another POU may see of a function block


class Scope:
    """Names of one POU, method or list, and those of what is around it."""

    def __init__(self, model: "Model", label: str, prefix: str, parent: "Scope | None" = None) -> None:
        self.model, self.label, self.parent = model, label, parent
        self.part = ""  # "declaration " or "implementation " where a file counts their lines apart
        self.block: FunctionBlock | None = parent.block if parent else None
        self._prefix = prefix
        self._declared: dict[str, tuple[ast.Block | None, ast.Declaration]] = {}
        self._found: dict[str, Variable] = {}

    def fail(self, line: int, text: str) -> NoReturn:
        """A type error that says where."""
        raise StTypeError(f"{self.label} {self.part}line {line}: {text}")

    def declare(self, blocks: Iterable[ast.Block]) -> None:
        """Take the names of VAR blocks."""
        for block in blocks:
            for declaration in block.declarations:
                self.declare_one(block, declaration)

    def declare_one(self, block: ast.Block | None, declaration: ast.Declaration) -> None:
        """Take one name."""
        lower = declaration.name.lower()
        if lower in self._declared or lower in self._found:
            self.fail(declaration.line, f"{declaration.name} is declared twice")
        self._declared[lower] = (block, declaration)

    def add(self, variable: Variable) -> None:
        """Take a name that no block declares: a result."""
        if variable.name.lower() in self._declared:
            self.fail(variable.line, f"{variable.name} is the name of the result")
        self._found[variable.name.lower()] = variable

    def own(self, name: str) -> Variable | None:
        """A variable of this very scope."""
        lower = name.lower()
        if lower not in self._found and lower in self._declared:
            self._found[lower] = self._resolve(*self._declared[lower])
        return self._found.get(lower)

    def find(self, name: str) -> Variable | None:
        """A variable of this scope or one around it."""
        found = self.own(name)
        if found is None:
            return self.parent.find(name) if self.parent else self.model.unqualified(name)
        return found

    def variables(self, *kinds: str) -> list[Variable]:
        """Own variables in the order of their declaration; of some kinds of block only."""
        found = [self.own(lower) for lower in self._declared]
        return [variable for variable in found if variable and (not kinds or variable.kind in kinds)]

    def _resolve(self, block: ast.Block | None, declaration: ast.Declaration) -> Variable:
        key = (self.label, declaration.name.lower())
        if key in self.model.busy:
            self.fail(declaration.line, f"{declaration.name} depends on itself")
        self.model.busy.add(key)
        before, self.part = self.part, self.model.part(self.label, "declaration ")
        try:
            return self._resolved(block, declaration)
        finally:
            self.part = before
            self.model.busy.discard(key)

    def _resolved(self, block: ast.Block | None, declaration: ast.Declaration) -> Variable:
        kind = self.model.resolve(declaration.type, self)
        constant = bool(block and block.constant)
        found = Variable(
            declaration.name,
            kind,
            block.kind if block else "FIELD",
            declaration.line,
            constant,
            declaration.initial,
            self._prefix + python_name(declaration.name),
        )
        if constant and isinstance(kind, Elementary | Enum):
            if declaration.initial is None:
                self.fail(declaration.line, f"constant {declaration.name} has no value")
            found.const = self.model.evaluate(declaration.initial, self, kind, declaration.name)
        elif constant:
            found.code = f"_c_{self.label.replace('.', '__')}__{declaration.name}"
        return found


Compile = Callable[[ast.Expression, Scope], Value]


class Model:
    """All sources together."""

    def __init__(self, units: Iterable[ast.Unit], compile_expression: Compile, without: Iterable[str] = ()) -> None:
        self._compile = compile_expression
        self._without = {name.lower() for name in without}
        self.busy: set[tuple[str, str]] = set()
        self.types: dict[str, Type] = {name.lower(): kind for name, kind in ELEMENTARY.items()}
        self.pous: dict[str, ast.Pou] = {}
        self.skipped: list[str] = []
        self.kept: dict[str, Type] = {}  # types that the Python source names
        self.global_scopes: dict[str, Scope] = {}
        self.global_names: dict[str, str] = {}
        self.functions: dict[str, Signature] = {}
        self._open: list[str] = []
        self._sources: dict[str, ast.Record | ast.Enumeration | ast.Alias] = {}
        self._in_parts: set[str] = set()
        self._pou_scopes: dict[str, Scope] = {}
        self._method_scopes: dict[tuple[str, str], Scope] = {}
        for unit in units:
            for item in unit.items:
                self._take(unit, item)

    def part(self, label: str, part: str) -> str:
        """The word for the part, if the POU's file counts lines of declaration and implementation apart."""
        return part if label.split(".")[0] in self._in_parts else ""

    def _take(self, unit: ast.Unit, item: ast.Pou | ast.Record | ast.Enumeration | ast.Alias | ast.Globals) -> None:
        lower = item.name.lower()
        if lower in self._sources or lower in self.pous or lower in self.global_scopes:
            raise StTypeError(f"{unit.source}: {item.name} is declared twice")
        if isinstance(item, ast.Globals):
            self._take_globals(unit, item)
        elif not isinstance(item, ast.Pou):
            self._sources[lower] = item
        elif item.inherits or lower in self._without:
            self.skipped.append(item.name)
        else:
            self._take_pou(unit, item)

    def _take_globals(self, unit: ast.Unit, item: ast.Globals) -> None:
        scope = Scope(self, item.name, f"_v_{item.name}.")
        scope.declare(item.blocks)
        self.global_scopes[item.name.lower()] = scope
        self.global_names[item.name.lower()] = item.name
        if "qualified_only" not in unit.attributes:
            self._open.append(item.name.lower())

    def _take_pou(self, unit: ast.Unit, item: ast.Pou) -> None:
        lower = item.name.lower()
        self.pous[lower] = item
        if unit.parts:
            self._in_parts.add(item.name)
        if item.kind != "FUNCTION":
            self.types[lower] = FunctionBlock(item.name, f"_g_{item.name}")

    def unqualified(self, name: str) -> Variable | None:
        """A variable of a list that is not qualified_only."""
        for lower in self._open:
            found = self.global_scopes[lower].own(name)
            if found is not None:
                return found
        return None

    def named_type(self, name: str) -> Type | None:
        """A type by its name, any spelling."""
        lower = name.lower()
        if lower not in self.types and lower in self._sources:
            self._make_type(lower, self._sources[lower])
        found = self.types.get(lower)
        if isinstance(found, FunctionBlock) and not found.variables:
            self.pou_scope(found.name)
        return found

    def type_names(self) -> list[str]:
        """Names of all declared data types."""
        return [source.name for source in self._sources.values()]

    def _make_type(self, lower: str, source: ast.Record | ast.Enumeration | ast.Alias) -> None:
        scope = Scope(self, source.name, "")
        if isinstance(source, ast.Alias):
            self.types[lower] = self.resolve(source.type, scope)
        elif isinstance(source, ast.Enumeration):
            self.types[lower] = self._make_enum(source, scope)
        else:
            record = Record(source.name, source.kind == "UNION")
            self.types[lower] = record
            for declaration in source.fields:
                scope.declare_one(None, declaration)
            record.fields = {field.name.lower(): field for field in scope.variables()}

    def _make_enum(self, source: ast.Enumeration, scope: Scope) -> Enum:
        base = ELEMENTARY.get(source.base.upper())
        if base is None or not base.is_integer:
            scope.fail(source.line, f"{source.base} is no base type for an enum")
        items: dict[str, tuple[str, int]] = {}
        number = 0
        for name, value in source.items:
            if value is not None:
                number = int(self.evaluate(value, scope, base, name))
            if not base.lo <= number <= base.hi or name.lower() in items:
                scope.fail(source.line, f"{name} = {number}: twice, or not in {base.name}")
            items[name.lower()] = (name, number)
            number += 1
        numbers = [value for _, value in items.values()]
        default = items[source.default.lower()][1] if source.default else 0 if 0 in numbers else numbers[0]
        return Enum(source.name, base, items, default)

    def resolve(self, ref: ast.TypeRef, scope: Scope) -> Type:
        """The type that a declaration names."""
        if isinstance(ref, ast.PointerType):
            if ref.kind == "REFERENCE":
                scope.fail(ref.line, "REFERENCE TO is not in the dialect")
            return Pointer(self.resolve(ref.target, scope))
        if isinstance(ref, ast.NamedType):
            found = None if ref.sized else self.named_type(ref.name)
            if found is None:
                scope.fail(ref.line, f"unknown type {ref.name}")
            return found
        kind = self.resolve(ref.element, scope)
        for first, last in reversed(ref.ranges):
            lower, upper = (int(self.evaluate(e, scope, ELEMENTARY["LINT"], "array bound")) for e in (first, last))
            if upper < lower:
                scope.fail(ref.line, f"array bounds {lower}..{upper}")
            kind = Array(lower, upper, kind)
        return kind

    def evaluate(self, initial: ast.Initial, scope: Scope, kind: Type, what: str) -> bool | int | float:
        """The value of a constant expression, as a value of `kind`."""
        if isinstance(initial, ast.ArrayInitial | ast.StructInitial):
            scope.fail(initial.line, f"{what}: {kind.name} takes one value")
        value = self._compile(initial, scope)
        if value.const is None:
            scope.fail(initial.line, f"{what}: not a constant")
        try:
            found = converted(value, kind, what).const
        except MismatchError as error:
            scope.fail(initial.line, str(error))
        if found is None:
            scope.fail(initial.line, f"{what}: not a constant")
        return found

    def pou_scope(self, name: str) -> Scope:
        """Names of a POU; fills the function block's type."""
        lower = name.lower()
        self.function(name)
        if lower not in self._pou_scopes:
            pou = self.pous[lower]
            scope = Scope(self, pou.name, "self.")
            self._pou_scopes[lower] = scope
            try:
                self._fill_block(pou, scope)
            except StTypeError:
                del self._pou_scopes[lower]  # who asks again gets the same error
                raise
        return self._pou_scopes[lower]

    def _fill_block(self, pou: ast.Pou, scope: Scope) -> None:
        block = self.types[pou.name.lower()]
        if isinstance(block, FunctionBlock):
            scope.declare(pou.blocks)
            scope.block = block
            block.variables = {variable.name.lower(): variable for variable in scope.variables()}
            block.methods.clear()
            self._fill_methods(pou, scope, block)

    def _fill_methods(self, pou: ast.Pou, scope: Scope, block: FunctionBlock) -> None:
        for method in pou.methods:
            lower = method.name.lower()
            if lower in block.methods or lower in block.variables:
                scope.fail(method.line, f"{method.name} is declared twice")
            inner = Scope(self, f"{pou.name}.{method.name}", "", scope)
            self._method_scopes[pou.name.lower(), lower] = inner
            block.methods[lower] = self._signature(
                inner, f"_g_{pou.name}__{method.name}", method.name, method.blocks, method.result, method.line
            )

    def method_scope(self, pou: ast.Pou, method: ast.Method) -> Scope:
        """Names of a method, with the block's around them."""
        self.pou_scope(pou.name)
        return self._method_scopes[pou.name.lower(), method.name.lower()]

    def names_in(self, label: str) -> set[str]:
        """Names that the body of a method (label POU.Method) uses."""
        pou_name, method_name = label.split(".")
        methods = self.pous[pou_name.lower()].methods
        return {name for method in methods if method.name == method_name for name in named(method.body)}

    def function(self, name: str) -> Signature | None:
        """How a FUNCTION is called."""
        lower = name.lower()
        pou = self.pous.get(lower)
        if pou is None or pou.kind != "FUNCTION":
            return None
        if lower not in self.functions:
            scope = Scope(self, pou.name, "")
            self._pou_scopes[lower] = scope
            self.functions[lower] = self._signature(scope, f"_g_{pou.name}", pou.name, pou.blocks, pou.result, pou.line)
        return self.functions[lower]

    def _signature(
        self,
        scope: Scope,
        code: str,
        name: str,
        blocks: tuple[ast.Block, ...],
        result_ref: ast.TypeRef | None,
        line: int,
    ) -> Signature:
        scope.declare(blocks)
        result = self.resolve(result_ref, scope) if result_ref else None
        if result:
            scope.add(Variable(name, result, "RESULT", line, code=python_name(name)))
        inputs = scope.variables("VAR_INPUT", "VAR_IN_OUT")
        return Signature(scope.label, code, inputs, scope.variables("VAR_OUTPUT"), result)


def is_visible(variable: Variable) -> bool:
    """Whether another POU may name this variable of a function block."""
    return variable.kind in _OUTSIDE
