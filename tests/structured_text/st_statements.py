"""Statements as Python source."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import st_ast as ast
from st_calls import Calls, condition
from st_emitter import Emitter
from st_errors import StTypeError
from st_model import Scope
from st_names import calls, changed, named
from st_types import Elementary, Enum, Variable
from st_values import MismatchError, Value, converted, exact, settled


@dataclass(frozen=True, slots=True)
class _Bounds:
    variable: Variable
    kind: Elementary
    first: Value
    last: Value
    step: int


class Statements(Calls):
    """Translates a body. `result` is what RETURN gives back, as Python source."""

    def __init__(self, scope: Scope, emitter: Emitter, result: str, errors: list[StTypeError] | None = None) -> None:
        super().__init__(scope, emitter)
        self._errors = errors  # where type errors are collected; None: the first is raised
        self._result = result
        self._loops: list[Callable[[int], None]] = []  # what comes before a CONTINUE

    def body(self, statements: tuple[ast.Statement, ...]) -> None:
        """All statements; `pass` where there is none."""
        before = len(self.out.lines)
        for statement in statements:
            self.inline_methods = 0
            try:
                self._statement(statement)
            except StTypeError as error:
                if self._errors is None:
                    raise
                self._errors.append(error)
        if len(self.out.lines) == before:
            self.out.emit("pass", 0)

    def _statement(self, statement: ast.Statement) -> None:
        found: dict[type, Callable[[Any], None]] = {
            ast.Assign: self._assignment,
            ast.CallStatement: self.call_statement,
            ast.If: self._if,
            ast.Case: self._case,
            ast.For: self._for,
            ast.While: self._while,
            ast.Repeat: self._repeat,
            ast.Jump: self._jump,
        }
        self.out.mark(statement.line)
        found[type(statement)](statement)

    def _block(self, statements: tuple[ast.Statement, ...]) -> None:
        with self.out.deeper():
            self.body(statements)

    def _assignment(self, node: ast.Assign) -> None:
        place = self.location(node.target)
        value = self.value(node.value)
        self.assign(place, value, node.line, f"assignment to {_text(node.target)}")

    def _condition(self, expression: ast.Expression) -> str:
        self.inline_methods = 0
        try:
            return condition(self.value(expression))
        except MismatchError as error:
            raise self._located(expression.line, error) from error

    def _if(self, node: ast.If) -> None:
        self._branches(list(node.branches), node.otherwise, "if")

    def _branches(
        self,
        branches: list[tuple[ast.Expression, tuple[ast.Statement, ...]]],
        otherwise: tuple[ast.Statement, ...],
        word: str,
    ) -> None:
        if not branches:
            if otherwise:
                self.out.emit("else:", 0)
                self._block(otherwise)
            return
        (expression, body), rest = branches[0], branches[1:]
        with self.out.caught() as lines:
            code = self._condition(expression)
        if word == "elif" and lines:  # the condition needs statements of its own
            self.out.emit("else:", expression.line)
            self.out.place(lines, 1)
            with self.out.deeper():
                self.out.emit(f"if {code}:", expression.line)
                self._block(body)
                self._branches(rest, otherwise, "elif")
            return
        self.out.place(lines)
        self.out.emit(f"{word} {code}:", expression.line)
        self._block(body)
        self._branches(rest, otherwise, "elif")

    def _case(self, node: ast.Case) -> None:
        selector = exact(self.value(node.selector))
        kind = selector.type
        if not isinstance(kind, Enum) and not (isinstance(kind, Elementary) and kind.is_integer):
            self.fail(node.line, f"CASE of {kind.name}")
        name = selector.code
        if not selector.simple:
            name = self.out.temporary()
            self.out.emit(f"{name} = {selector.code}", node.line)
        seen: set[int] = set()
        word = "if"
        for labels, body in node.branches:
            self.out.emit(f"{word} {self._label_test(name, selector, labels, seen)}:", labels[0].line)
            self._block(body)
            word = "elif"
        if node.otherwise and word == "elif":
            self.out.emit("else:", node.line)
            self._block(node.otherwise)
        elif node.otherwise:
            self.body(node.otherwise)

    def _label_test(self, name: str, selector: Value, labels: tuple[ast.Label, ...], seen: set[int]) -> str:
        singles, tests = [], []
        for label in labels:
            first = self._label(label.first, selector)
            last = first if label.last is None else self._label(label.last, selector)
            if last < first or (last - first < 1 << 20 and not seen.isdisjoint(range(first, last + 1))):
                self.fail(label.line, f"CASE label {first}..{last} is met by another, or its ends are swapped")
            seen.update(range(first, last + 1) if last - first < 1 << 20 else ())
            if label.last is None:
                singles.append(first)
            else:
                tests.append(f"{first} <= {name} <= {last}")
        if len(singles) == 1:
            tests.insert(0, f"{name} == {singles[0]}")
        elif singles:
            tests.insert(0, f"{name} in ({', '.join(map(str, singles))})")
        return " or ".join(tests)

    def _label(self, expression: ast.Expression, selector: Value) -> int:
        value = self.value(expression)
        if value.const is None:
            return self.fail(expression.line, "a CASE label is a constant")
        if isinstance(value.type, Enum) and selector.type is value.type.base:
            return int(value.const)
        found = self.convert(value, selector.type, "CASE label", expression.line).const
        return int(found) if found is not None else self.fail(expression.line, "a CASE label is a constant")

    def _for(self, node: ast.For) -> None:
        bounds = self._bounds(node)
        local = bounds.variable.code.isidentifier()
        touched = changed(node.body)
        if local and node.variable.lower() not in touched and self._is_stable(node.last, touched, node.body):
            self._for_range(node, bounds)
        else:
            self._for_while(node, bounds)

    def _bounds(self, node: ast.For) -> _Bounds:
        variable = self.scope.find(node.variable)
        if variable is None:
            return self.fail(node.line, f"unknown name {node.variable}")
        kind = variable.type
        if not isinstance(kind, Elementary) or not kind.is_integer or variable.constant:
            return self.fail(node.line, f"FOR variable {node.variable} is {kind.name}")
        first = self._converted(node.first, kind, "FOR start")
        last = self._converted(node.last, kind, "FOR end")
        step = self.value(node.step).const if node.step else 1
        if not isinstance(step, int) or isinstance(step, bool) or step == 0:
            return self.fail(node.line, "FOR step must be a constant, not 0")
        return _Bounds(variable, kind, first, last, step)

    def _converted(self, expression: ast.Expression, kind: Elementary, what: str) -> Value:
        value = self.value(expression)
        try:
            return exact(converted(exact(value), kind, what))
        except MismatchError as error:
            raise self._located(expression.line, error) from error

    def _is_stable(self, last: ast.Expression, touched: set[str], body: tuple[ast.Statement, ...]) -> bool:
        """Whether the end stays the same while the body runs."""
        names = named(last)
        if names & touched or any(self._is_own(call) for call in calls(last)):
            return False
        found = [self.scope.find(name) for name in names]
        all_local = all(v is None or v.const is not None or v.code.isidentifier() for v in found)
        return all_local or not any(self._is_own(call) for call in calls(body))

    def _is_own(self, call: ast.Call) -> bool:
        """A call of the program's own code, which may change what is not local."""
        if not isinstance(call.target, ast.Name):
            return True
        name = call.target.text
        method = self.scope.block is not None and name.lower() in self.scope.block.methods
        return method or self.model.function(name) is not None or self.scope.find(name) is not None

    def _for_range(self, node: ast.For, bounds: _Bounds) -> None:
        variable, kind, step = bounds.variable, bounds.kind, bounds.step
        first, last = bounds.first, bounds.last
        if not last.simple:
            name = self.out.temporary()
            self.out.emit(f"{name} = {last.code}", node.line)
            last = Value(name, last.type, last.lo, last.hi, simple=True)
        if not first.simple:
            name = self.out.temporary()
            self.out.emit(f"{name} = {first.code}", node.line)
            first = Value(name, first.type, first.lo, first.hi, simple=True)
        limit = kind.hi if step > 0 else kind.lo
        end = last.code
        if last.lo <= limit <= last.hi:
            end = f"_st_end({last.code}, {limit})"
        stop = f"{end} + 1" if step > 0 else f"{end} - 1"
        by = f", {step}" if step != 1 else ""
        self.out.emit(f"for {variable.code} in _st_range({first.code}, {stop}{by}):", node.line)
        known = (first.lo, last.hi) if step > 0 else (last.lo, first.hi)
        self._ranged_body(node, variable, known)
        self.out.emit("else:", node.line)
        with self.out.deeper():
            self.out.emit(f"{variable.code} = {_after(first, last, step)}", node.line)

    def _ranged_body(self, node: ast.For, variable: Variable, known: tuple[int, int]) -> None:
        before = dict(self.ranges.known)
        if known[0] <= known[1]:
            self.ranges.known[variable.code] = known
        self._loops.append(lambda line: None)
        self._block(node.body)
        self._loops.pop()
        self.ranges.known = before

    def _for_while(self, node: ast.For, bounds: _Bounds) -> None:
        code, kind, step = bounds.variable.code, bounds.kind, bounds.step
        self.out.emit(f"{code} = {bounds.first.code}", node.line)
        stepped = settled(Value(f"({code} + {step})", kind, kind.lo + min(step, 0), kind.hi + max(step, 0)))

        def advance(line: int) -> None:
            self.out.emit(f"{code} = {stepped.code}", line)

        self.out.emit("while True:", node.line)
        with self.out.deeper():
            last = self._converted(node.last, kind, "FOR end")
            limit = kind.hi if step > 0 else kind.lo
            end = f"_st_end({last.code}, {limit})" if last.lo <= limit <= last.hi else last.code
            self.out.emit(f"if {code} {'>' if step > 0 else '<'} {end}:", node.line)
            with self.out.deeper():
                self.out.emit("break", node.line)
            self._loops.append(advance)
            self.body(node.body)
            self._loops.pop()
            advance(node.line)

    def _while(self, node: ast.While) -> None:
        with self.out.caught() as lines:
            code = self._condition(node.condition)
        self.out.emit(f"while {'True' if lines else code}:", node.line)
        with self.out.deeper():
            if lines:
                self.out.place(lines, 1)
                self._break_if(f"not {code}", node.line)
            self._loops.append(lambda line: None)
            self.body(node.body)
            self._loops.pop()

    def _break_if(self, code: str, line: int) -> None:
        self.out.emit(f"if {code}:", line)
        with self.out.deeper():
            self.out.emit("break", line)

    def _repeat(self, node: ast.Repeat) -> None:
        def until(line: int) -> None:
            self._break_if(self._condition(node.condition), line)

        self.out.emit("while True:", node.line)
        with self.out.deeper():
            self._loops.append(until)
            self.body(node.body)
            self._loops.pop()
            until(node.condition.line)

    def _jump(self, node: ast.Jump) -> None:
        if node.kind == "RETURN":
            self.out.emit(self._result, node.line)
            return
        if not self._loops:
            self.fail(node.line, f"{node.kind} outside a loop")
        if node.kind == "EXIT":
            self.out.emit("break", node.line)
            return
        self._loops[-1](node.line)
        self.out.emit("continue", node.line)


def _after(first: Value, last: Value, step: int) -> str:
    """The loop variable after the loop."""
    if first.const is not None and last.const is not None:
        steps = range(int(first.const), int(last.const) + (1 if step > 0 else -1), step)
        return str(steps.start + step * len(steps))
    if step == 1:
        return f"{last.code} + 1 if {last.code} >= {first.code} else {first.code}"
    over = f"{last.code} - {first.code}" if step > 0 else f"{first.code} - {last.code}"
    return f"{first.code} + ({over} + {abs(step)}) // {abs(step)} * {step} if {over} >= 0 else {first.code}"


def _text(expression: ast.Expression) -> str:
    """A place as the programmer wrote it, nearly."""
    if isinstance(expression, ast.Name):
        return expression.text
    if isinstance(expression, ast.Member):
        return f"{_text(expression.base)}.{expression.name}"
    if isinstance(expression, ast.Index):
        return f"{_text(expression.base)}[]"
    return "THIS^" if isinstance(expression, ast.Deref) else "this"
