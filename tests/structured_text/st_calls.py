"""Calls of functions, methods and function blocks: arguments, results, outputs; assignments to places."""

from dataclasses import dataclass, replace

import st_ast as ast
from st_builtins import Builtins
from st_expressions import Location
from st_names import root
from st_types import (
    BOOL,
    Array,
    Elementary,
    Enum,
    FunctionBlock,
    Pointer,
    Record,
    Signature,
    Type,
    Variable,
    is_shared,
)
from st_values import MismatchError, Value, logic, ranged, settled


@dataclass(frozen=True, slots=True)
class Callee:
    """What is called: a signature, and the instance's code for a method."""

    signature: Signature
    instance: str = ""


class Calls(Builtins):
    """Calls, in expressions and as statements. What must happen before the expression is emitted first."""

    inline_methods = 0  # calls already inside the expression being translated

    def call_value(self, call: ast.Call) -> Value:
        """A call inside an expression."""
        if isinstance(call.target, ast.Name):
            value = self.builtin(call.target.text.upper(), call)
            if value is not None:
                return value
        callee = self._callee(call)
        if callee is None:
            return self.fail(call.line, "a function block has no value: call it on its own")
        if callee.signature.result is None:
            return self.fail(call.line, f"{callee.signature.label} has no value")
        return self._called(callee, call)

    def _callee(self, call: ast.Call) -> Callee | None:
        """The method or function; None: a function block instance."""
        target = call.target
        if isinstance(target, ast.Name):
            return self._called_by_name(target)
        if not isinstance(target, ast.Member):
            self.location(target)
            return None
        base = target.base
        if isinstance(base, ast.Deref) and isinstance(base.base, ast.Name) and base.base.text.upper() == "THIS":
            own = self.scope.block.methods.get(target.name.lower()) if self.scope.block else None
            return Callee(own, "self") if own else self.fail(call.line, f"THIS^ has no method {target.name}")
        place = None
        if not (isinstance(base, ast.Name) and base.text.lower() in self.model.global_scopes):
            place = self.location(base)
        if place is not None and isinstance(place.type, FunctionBlock):
            method = place.type.methods.get(target.name.lower())
            if method:
                return Callee(method, place.code)
        if isinstance(self.location(target).type, FunctionBlock):
            return None
        return self.fail(call.line, f"{target.name} is no method")

    def _called_by_name(self, target: ast.Name) -> Callee | None:
        block = self.scope.block
        if block and target.text.lower() in block.methods:
            return Callee(block.methods[target.text.lower()], "self")
        function = self.model.function(target.text)
        if function:
            return Callee(function)
        variable = self.scope.find(target.text)
        if variable is None:
            return self.fail(target.line, f"unknown function {target.text}")
        if not isinstance(variable.type, FunctionBlock):
            return self.fail(target.line, f"{target.text} is no function")
        return None

    def _called(self, callee: Callee, call: ast.Call) -> Value:
        """The result, inline where nothing else comes back; else emitted before, with the outputs stored."""
        signature = callee.signature
        given = self._bound(signature, call)
        before = self.inline_methods
        self._check_aliases(callee, given, call.line)
        codes = [callee.instance] if callee.instance else []
        codes += [self._argument(parameter, given, call.line, signature.label) for parameter in signature.parameters]
        code = f"{signature.code}({', '.join(codes)})"
        if not signature.returned:
            self.inline_methods += 1 if callee.instance else 0
            return ranged(code, signature.result) if signature.result else Value(code, BOOL)
        if before:
            self.fail(call.line, f"{signature.label}: its outputs need a statement of its own, another call is before")
        self.inline_methods = before
        return self._unpacked(signature, code, given, call)

    def _check_aliases(self, callee: Callee, given: dict[str, ast.Argument], line: int) -> None:
        """A scalar VAR_IN_OUT is copied in and out here: refuse what a true reference would do otherwise."""
        seen: set[str] = set()
        for parameter in callee.signature.parameters:
            argument = given.get(parameter.name.lower())
            if parameter.kind != "VAR_IN_OUT" or is_shared(parameter.type) or not argument or not argument.value:
                continue
            code, name = self.location(argument.value).code, root(argument.value)
            own = callee.instance == "self" and self.scope.block is not None and name in self.scope.block.variables
            if code in seen or (own and name in self.model.names_in(callee.signature.label)):
                self.fail(line, f"{callee.signature.label}.{parameter.name}: {name} is also reached by another way")
            seen.add(code)

    def _unpacked(self, signature: Signature, code: str, given: dict[str, ast.Argument], call: ast.Call) -> Value:
        names = [self.out.temporary() for _ in signature.returned]
        result = [self.out.temporary()] if signature.result else []
        self.out.emit(f"{', '.join(result + names)} = {code}", call.line)
        for variable, name in zip(signature.returned, names, strict=True):
            argument = given.get(variable.name.lower())
            if argument is not None and argument.value is not None:
                place = self.location(argument.value)
                what = f"{signature.label}.{variable.name}"
                self.assign(place, Value(name, variable.type, *_bounds(variable.type)), call.line, what)
        if signature.result:
            return ranged(result[0], signature.result, simple=True)
        return Value("None", BOOL)

    def _bound(self, signature: Signature, call: ast.Call) -> dict[str, ast.Argument]:
        """Arguments by lower case parameter name."""
        found: dict[str, ast.Argument] = {}
        names = [parameter.name for parameter in signature.parameters]
        outputs = {variable.name.lower() for variable in signature.outputs}
        for position, argument in enumerate(call.arguments):
            if not argument.name and position >= len(names):
                self.fail(call.line, f"{signature.label} takes {len(names)} arguments")
            lower = (argument.name or names[position]).lower()
            known = outputs if argument.is_output else {name.lower() for name in names}
            if lower not in known:
                self.fail(call.line, f"{signature.label} has no parameter {argument.name}")
            if lower in found:
                self.fail(call.line, f"{signature.label}: {argument.name or names[position]} is given twice")
            found[lower] = argument
        return found

    def _argument(self, parameter: Variable, given: dict[str, ast.Argument], line: int, label: str) -> str:
        argument = given.get(parameter.name.lower())
        what = f"{label}.{parameter.name}"
        if argument is None or argument.value is None:
            if parameter.initial is None or parameter.kind == "VAR_IN_OUT":
                return self.fail(line, f"{what} is not given")
            return self.default(parameter.type, parameter.initial, what)
        if parameter.kind == "VAR_IN_OUT":
            return self._by_reference(argument.value, parameter.type, what)
        return self.input_code(argument.value, parameter.type, what)

    def input_code(self, expression: ast.Expression, kind: Type, what: str) -> str:
        """An argument by value."""
        value = self.convert(self.value(expression), kind, what, expression.line)
        return self.copied(value, what, expression.line)

    def _by_reference(self, expression: ast.Expression, kind: Type, what: str) -> str:
        place = self.location(expression)
        if place.blocked:
            self.fail(expression.line, f"{what} is VAR_IN_OUT: {place.blocked}")
        if place.type != kind:
            self.fail(expression.line, f"{what} is VAR_IN_OUT {kind.name}, given {place.type.name}")
        if place.owner and is_shared(kind):
            return f"_st_finite({self.view(place)})"
        return self.load(place, expression.line).code

    def assign(self, place: Location, value: Value, line: int, what: str) -> None:
        """Emit place := value."""
        if place.blocked:
            self.fail(line, f"{what}: {place.blocked}")
        if isinstance(place.type, FunctionBlock):
            self.fail(line, f"{what}: a function block is not assigned")
        value = self.convert(value, place.type, what, line)
        if place.owner:
            value = replace(value, code=value.code.removeprefix("_st_finite"))  # bytes move, nothing is calculated
        if isinstance(place.type, Elementary | Enum | Pointer):
            plain = place.type.base if isinstance(place.type, Enum) else place.type
            target = self.memory_item(place, plain) if place.owner and isinstance(plain, Elementary) else place.code
            self.out.emit(f"{target} = {value.code}", line)
        elif isinstance(place.type, Record):
            target = self.view(place) if place.owner else place.code
            self.out.emit(f"{target}.st_set({value.code})", line)
        else:
            self._assign_array(place, value, line)

    def _assign_array(self, place: Location, value: Value, line: int) -> None:
        kind = place.type
        flat = isinstance(kind, Array) and isinstance(kind.element, Elementary | Enum | Pointer)
        if place.owner or place.parameter or not flat:
            target = self.view(place) if place.owner else place.code
            self.out.emit(f"_st_items({target}, {value.code})", line)
        else:
            self.out.emit(f"{place.code}[:] = {value.code}", line)

    def short_circuit(self, node: ast.Binary, left: Value) -> Value:
        """AND_THEN, OR_ELSE: what the right side emits happens only if it is looked at."""
        with self.out.caught() as lines:
            right = self.value(node.right)
        both = self._logic(node, left, right)
        if not lines:
            return both
        name = self.out.temporary()
        self.out.emit(f"{name} = {left.code}", node.line)
        self.out.emit(f"if {name}:" if node.op == "AND_THEN" else f"if not {name}:", node.line)
        self.out.place(lines, 1)
        with self.out.deeper():
            self.out.emit(f"{name} = {right.code}", node.line)
        return Value(name, BOOL, simple=True)

    def _logic(self, node: ast.Binary, left: Value, right: Value) -> Value:
        try:
            return logic(node.op, left, right)
        except MismatchError as error:
            raise self._located(node.line, error) from error

    def call_statement(self, node: ast.CallStatement) -> None:
        """A call on its own."""
        call = node.call
        if not isinstance(call, ast.Call):
            self.fail(node.line, "a statement without effect")
            return
        if isinstance(call.target, ast.Name):
            value = self.builtin(call.target.text.upper(), call)
            if value is not None:
                self.out.emit(value.code, node.line)
                return
        callee = self._callee(call)
        if callee is None:
            self._call_block(self.location(call.target), call)
        else:
            value = self._called(callee, call)
            if not callee.signature.returned:
                self.out.emit(value.code, node.line)

    def _call_block(self, place: Location, call: ast.Call) -> None:
        """fb(a := 1, b => x): inputs are set, the body runs, outputs are read."""
        block = place.type
        if not isinstance(block, FunctionBlock):
            self.fail(call.line, f"{block.name} is not called")
            return
        reads: list[tuple[ast.Expression, Variable]] = []
        given: set[str] = set()
        for argument in call.arguments:
            self._block_argument(place, block, argument, reads, call.line)
            given.add(argument.name.lower())
        for variable in block.variables.values():
            if variable.kind == "VAR_IN_OUT" and variable.name.lower() not in given:
                self.fail(call.line, f"{block.name}.{variable.name} is VAR_IN_OUT and not given")
        self.out.emit(f"{block.code}__body_({place.code})", call.line)
        for target, variable in reads:
            value = ranged(f"{place.code}.{variable.code.removeprefix('self.')}", variable.type)
            self.assign(self.location(target), value, call.line, f"{block.name}.{variable.name}")

    def _block_argument(
        self,
        place: Location,
        block: FunctionBlock,
        argument: ast.Argument,
        reads: list[tuple[ast.Expression, Variable]],
        line: int,
    ) -> None:
        variable = block.variables.get(argument.name.lower())
        kinds = ("VAR_OUTPUT",) if argument.is_output else ("VAR_INPUT", "VAR_IN_OUT")
        if variable is None or variable.kind not in kinds:
            self.fail(line, f"{block.name} has no parameter {argument.name or '(without a name)'}")
            return
        what = f"{block.name}.{variable.name}"
        if argument.value is None:
            return
        target = f"{place.code}.{variable.code.removeprefix('self.')}"
        if argument.is_output:
            reads.append((argument.value, variable))
        elif variable.kind == "VAR_IN_OUT":
            self.out.emit(f"{target} = {self._by_reference(argument.value, variable.type, what)}", line)
            if not is_shared(variable.type):
                reads.append((argument.value, variable))
        else:
            self.out.emit(f"{target} = {self.input_code(argument.value, variable.type, what)}", line)


def _bounds(kind: Type) -> tuple[int, int]:
    plain = kind.base if isinstance(kind, Enum) else kind
    return (plain.lo, plain.hi) if isinstance(plain, Elementary) else (0, 0)


def condition(value: Value) -> str:
    """A BOOL for IF, WHILE and UNTIL; MismatchError for anything else."""
    if value.type is not BOOL:
        raise MismatchError(f"a condition is BOOL, not {value.type.name}")
    return settled(value).code
