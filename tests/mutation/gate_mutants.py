"""Mutants of the motion gate: each differs from it in one place of its syntax tree."""

import ast
import copy
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass

LIMITS = {"q_min", "q_max", "qd_max", "qdd_max", "spacing_min_ns", "spacing_max_ns", "start_tolerance_rad", "ns"}
CONSTANTS = {"_ROUNDING", "_REST", "_BETWEEN", "KNOTS_PER_COMMAND", "SERVO_REACH_S", "MS"}
OTHER_CODE = {
    "RejectCode": "NONE",
    "PlcState": "BOOT",
    "Mode": "HOLD",
    "Interp": "CUBIC",
    "CommandFlag": "TAIL_REPLACES",
}
NEGATED: dict[type, type] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
SHIFTED: dict[type, type] = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
SWAPPED: dict[type, type] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
Change = tuple[str, Callable[[ast.AST], ast.AST]]


@dataclass(frozen=True)
class Mutant:
    """`key` names it: function, source of the place, change, and a number if that is not unique."""

    key: str
    line: int
    node: ast.AST
    change: Callable[[ast.AST], ast.AST]


def scaled(node: ast.expr, factor: float = 1.02) -> ast.expr:
    return ast.BinOp(node, ast.Mult(), ast.Constant(factor))


def _compare(node: ast.Compare) -> Iterator[Change]:
    for i, op in enumerate(node.ops):

        def with_op(old: ast.AST, kind: type, i: int = i) -> ast.AST:
            assert isinstance(old, ast.Compare)
            return ast.Compare(old.left, [*old.ops[:i], kind(), *old.ops[i + 1 :]], old.comparators)

        negated, shifted = NEGATED[type(op)], SHIFTED.get(type(op))
        yield f"comparison {i} negated", lambda old, w=with_op, k=negated: w(old, k)
        if shifted is not None:
            yield f"boundary {i} shifted", lambda old, w=with_op, k=shifted: w(old, k)
            yield f"operand {i + 1} scaled", lambda old, i=i: _with_operand(old, i + 1)
            if i == 0:
                yield "operand 0 scaled", lambda old: _with_operand(old, 0)


def _with_operand(node: ast.AST, i: int) -> ast.AST:
    assert isinstance(node, ast.Compare)
    operands = [node.left, *node.comparators]
    operands[i] = scaled(operands[i])
    return ast.Compare(operands[0], node.ops, operands[1:])


def _bool_op(node: ast.BoolOp) -> Iterator[Change]:
    swapped = ast.Or if isinstance(node.op, ast.And) else ast.And
    yield "and <-> or", lambda old: ast.BoolOp(swapped(), old.values)  # type: ignore[attr-defined]
    for i in range(len(node.values)):
        yield f"part {i} dropped", lambda old, i=i: _without(old, i)


def _without(node: ast.AST, i: int) -> ast.AST:
    if isinstance(node, ast.BoolOp):
        rest = [*node.values[:i], *node.values[i + 1 :]]
        return rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
    assert isinstance(node, ast.Tuple)
    return ast.Tuple([*node.elts[:i], *node.elts[i + 1 :]], node.ctx)


def _condition(old: ast.AST, value: bool) -> ast.AST:
    assert isinstance(old, ast.If | ast.IfExp)
    changed = copy.copy(old)
    changed.test = ast.Constant(value)
    return changed


def _constant(node: ast.Constant) -> Iterator[Change]:
    value = node.value
    if isinstance(value, bool):
        yield "flipped", lambda old: ast.Constant(not value)
    elif isinstance(value, int):
        yield "plus 1", lambda old: ast.Constant(value + 1)
    elif isinstance(value, float):
        yield "changed", lambda old: ast.Constant(value * 1.02 if value else 0.02)
    elif isinstance(value, str):
        yield "text changed", lambda old: ast.Constant(value + "?")


def _call(node: ast.Call) -> Iterator[Change]:
    if not isinstance(node.func, ast.Name):
        return
    name = node.func.id
    if name in ("max", "min"):
        other = ast.Name("min" if name == "max" else "max", ast.Load())
        yield "max <-> min", lambda old: ast.Call(other, old.args, [])  # type: ignore[attr-defined]
    elif name == "abs":
        yield "abs dropped", lambda old: old.args[0]  # type: ignore[attr-defined]
    elif name == "_over":
        yield "limit scaled", lambda old: _with_argument(old)


def _with_argument(node: ast.AST) -> ast.AST:
    assert isinstance(node, ast.Call)
    return ast.Call(node.func, [node.args[0], scaled(node.args[1])], [])


def _attribute(node: ast.Attribute) -> Iterator[Change]:
    if node.attr in LIMITS:
        yield "scaled by 1.02", lambda old: scaled(old)  # type: ignore[arg-type]
    owner = node.value
    if isinstance(owner, ast.Name) and owner.id in OTHER_CODE:
        other = OTHER_CODE[owner.id]
        yield f"{other} instead", lambda old: ast.Attribute(ast.Name(owner.id, ast.Load()), other, ast.Load())


def changes(node: ast.AST) -> Iterator[Change]:
    """Every change of one node."""
    match node:
        case ast.Compare():
            yield from _compare(node)
        case ast.BoolOp():
            yield from _bool_op(node)
        case ast.If() | ast.IfExp():
            yield "condition true", lambda old: _condition(old, True)
            yield "condition false", lambda old: _condition(old, False)
        case ast.Expr(value=ast.Yield() | ast.YieldFrom()):
            yield "removed", lambda old: ast.Pass()
        case ast.Return(value=None):
            yield "removed", lambda old: ast.Pass()
        case ast.UnaryOp():
            yield "sign or not dropped", lambda old: old.operand  # type: ignore[attr-defined]
        case ast.BinOp() if type(node.op) in SWAPPED:
            kind = SWAPPED[type(node.op)]
            yield "operator swapped", lambda old: ast.BinOp(old.left, kind(), old.right)  # type: ignore[attr-defined]
        case ast.Tuple(ctx=ast.Load()) if len(node.elts) > 1:
            for i in range(len(node.elts)):
                yield f"element {i} dropped", lambda old, i=i: _without(old, i)
        case ast.Constant():
            yield from _constant(node)
        case ast.Call():
            yield from _call(node)
        case ast.Attribute(ctx=ast.Load()):
            yield from _attribute(node)
        case ast.Name(ctx=ast.Load()) if node.id in CONSTANTS:
            yield "scaled by 1.02", lambda old: scaled(old)  # type: ignore[arg-type]
        case _:
            return


def _places(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Nodes that may be mutated, with the name of what they are in: bodies without docstrings, and the constants."""
    for statement in tree.body:
        match statement:
            case ast.FunctionDef():
                yield from _in_function(statement)
            case ast.ClassDef():
                for method in statement.body:
                    if isinstance(method, ast.FunctionDef):
                        yield from _in_function(method)
            case ast.Assign(targets=[ast.Name(id=name)]):
                for node in ast.walk(statement.value):
                    yield name, node
            case _:
                pass


def _in_function(function: ast.FunctionDef) -> Iterator[tuple[str, ast.AST]]:
    first = 1 if ast.get_docstring(function) is not None else 0
    for statement in function.body[first:]:
        for node in ast.walk(statement):
            yield function.name, node


def _parents(tree: ast.Module) -> dict[ast.AST, tuple[ast.AST, str, int | None]]:
    """Where each node hangs: its parent, the field, and the place in it if that is a list."""
    found: dict[ast.AST, tuple[ast.AST, str, int | None]] = {}
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if isinstance(value, ast.AST):
                found[value] = (parent, name, None)
            elif isinstance(value, list):
                found.update({item: (parent, name, i) for i, item in enumerate(value) if isinstance(item, ast.AST)})
    return found


def _put(parent: ast.AST, name: str, i: int | None, node: ast.AST) -> None:
    if i is None:
        setattr(parent, name, node)
    else:
        getattr(parent, name)[i] = node


class Mutation:
    """A module's source with all its mutants; `module` builds one and leaves the tree as it was."""

    def __init__(self, source: str) -> None:
        self._tree = ast.parse(source)
        self._parents = _parents(self._tree)
        self.mutants = tuple(self._mutants())

    def _mutants(self) -> Iterator[Mutant]:
        used: dict[str, int] = {}
        for where, node in _places(self._tree):
            for what, change in changes(node):
                key = f"{where}: {ast.unparse(node).splitlines()[0]}: {what}"
                used[key] = used.get(key, 0) + 1
                key += f" #{used[key]}" if used[key] > 1 else ""
                yield Mutant(key, getattr(node, "lineno", 0), node, change)

    def module(self, mutant: Mutant) -> types.ModuleType:
        """The mutated module, as if imported."""
        place = self._parents[mutant.node]
        _put(*place, ast.fix_missing_locations(ast.copy_location(mutant.change(mutant.node), mutant.node)))
        try:
            code = compile(self._tree, "mutated gate", "exec")
        finally:
            _put(*place, mutant.node)
        module = types.ModuleType("protocol.gate")
        exec(code, module.__dict__)
        return module
