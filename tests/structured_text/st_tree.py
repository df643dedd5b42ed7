"""From lark's parse to the syntax tree: one method for each rule of the grammar."""

import re
from typing import Any

import st_ast as ast
from lark import Token, Transformer, v_args
from lark.tree import Meta
from st_errors import StSyntaxError


def _number(text: str) -> int | float:
    plain = text.replace("_", "")
    if "#" in plain:
        base, digits = plain.split("#")
        return int(digits, int(base))
    return float(plain) if re.search(r"[.eE]", plain) else int(plain)


def _literal(token: Token) -> ast.Literal:
    line, text = token.line or 0, str(token)
    if token.type == "BOOLEAN":
        return ast.Literal(line, text.upper() == "TRUE", "BOOL")
    if token.type == "STRING":
        return ast.Literal(line, text[1:-1], "STRING")
    if token.type != "TYPED":
        return ast.Literal(line, _number(text))
    name, value = text.split("#", 1)
    if value.upper() in ("TRUE", "FALSE"):
        return ast.Literal(line, value.upper() == "TRUE", name.upper())
    try:
        return ast.Literal(line, _number(value), name.upper())
    except ValueError:
        return ast.Literal(line, value, name.upper())  # TIME and the like: parsed, not run


def _of(items: list[Any], *kinds: str) -> list[Token]:
    return [item for item in items if isinstance(item, Token) and item.type in kinds]


def _nodes(items: list[Any], kind: Any) -> tuple[Any, ...]:
    return tuple(item for item in items if isinstance(item, kind))


class _Body(tuple[ast.Statement, ...]):
    """Statements in order; a type of its own, so that a rule can tell them from other tuples."""


class _Else(_Body):
    pass


class _Labels(tuple[ast.Label, ...]):
    pass


class _Result:
    def __init__(self, type_ref: ast.TypeRef) -> None:
        self.type = type_ref


_INHERITS = object()


@v_args(meta=True)
class _Expressions(Transformer[Any, Any]):
    def literal(self, meta: Meta, items: list[Any]) -> ast.Literal:
        return _literal(items[0])

    def name(self, meta: Meta, items: list[Any]) -> ast.Name:
        return ast.Name(meta.line, str(items[0]))

    def member(self, meta: Meta, items: list[Any]) -> ast.Member:
        return ast.Member(meta.line, items[0], str(items[1]))

    def index(self, meta: Meta, items: list[Any]) -> ast.Index:
        return ast.Index(meta.line, items[0], tuple(items[1:]))

    def deref(self, meta: Meta, items: list[Any]) -> ast.Deref:
        return ast.Deref(meta.line, items[0])

    def call(self, meta: Meta, items: list[Any]) -> ast.Call:
        return ast.Call(meta.line, items[0], _nodes(items[1:], ast.Argument))

    def positional(self, meta: Meta, items: list[Any]) -> ast.Argument:
        return ast.Argument(meta.line, "", items[0])

    def named(self, meta: Meta, items: list[Any]) -> ast.Argument:
        return ast.Argument(meta.line, str(items[0]), items[1])

    def output(self, meta: Meta, items: list[Any]) -> ast.Argument:
        value = items[1] if len(items) > 1 else None
        return ast.Argument(meta.line, str(items[0]), value, is_output=True)

    def unary(self, meta: Meta, items: list[Any]) -> ast.Expression:
        op, operand = str(items[0]).upper(), items[1]
        if op == "-" and isinstance(operand, ast.Literal) and not isinstance(operand.value, bool | str):
            return ast.Literal(meta.line, -operand.value, operand.type_name)
        return ast.Unary(meta.line, op, operand)

    def plus(self, meta: Meta, items: list[Any]) -> ast.Expression:
        return items[1]

    def binary(self, meta: Meta, items: list[Any]) -> ast.Binary:
        op = {"&": "AND"}.get(str(items[1]), str(items[1]).upper())
        return ast.Binary(meta.line, op, items[0], items[2])


@v_args(meta=True)
class _Statements(_Expressions):  # pyright: ignore[reportGeneralTypeIssues] - lark's decorator is untyped
    def statements(self, meta: Meta, items: list[Any]) -> _Body:
        return _Body(items)

    def assign(self, meta: Meta, items: list[Any]) -> ast.Assign:
        return ast.Assign(meta.line, items[0], items[1])

    def call_statement(self, meta: Meta, items: list[Any]) -> ast.CallStatement:
        return ast.CallStatement(meta.line, items[0])

    def elsif(self, meta: Meta, items: list[Any]) -> tuple[Any, Any]:
        return items[0], items[1]

    def else_part(self, meta: Meta, items: list[Any]) -> _Else:
        return _Else(items[0])

    def by_part(self, meta: Meta, items: list[Any]) -> Any:
        return items[0]

    def if_statement(self, meta: Meta, items: list[Any]) -> ast.If:
        branches = [(items[0], items[1])]
        branches += [item for item in items[2:] if not isinstance(item, _Else)]
        otherwise = _nodes(items, _Else)
        return ast.If(meta.line, tuple(branches), otherwise[0] if otherwise else ())

    def label(self, meta: Meta, items: list[Any]) -> ast.Label:
        return ast.Label(meta.line, items[0], items[1] if len(items) > 1 else None)

    def labels(self, meta: Meta, items: list[Any]) -> _Labels:
        return _Labels(items)

    def nothing(self, meta: Meta, items: list[Any]) -> None:
        return None

    def case_statement(self, meta: Meta, items: list[Any]) -> ast.Case:
        branches: list[tuple[tuple[ast.Label, ...], list[ast.Statement]]] = []
        otherwise: tuple[ast.Statement, ...] = ()
        for item in items[1:]:
            if isinstance(item, _Labels):
                branches.append((item, []))
            elif isinstance(item, _Else):
                otherwise = item
            elif item is not None and branches:
                branches[-1][1].append(item)
            elif item is not None:
                raise StSyntaxError(f"line {item.line}: statement before the first CASE label")
        return ast.Case(meta.line, items[0], tuple((labels, tuple(body)) for labels, body in branches), otherwise)

    def for_statement(self, meta: Meta, items: list[Any]) -> ast.For:
        step = items[3] if len(items) == 5 else None
        return ast.For(meta.line, str(items[0]), items[1], items[2], step, items[-1])

    def while_statement(self, meta: Meta, items: list[Any]) -> ast.While:
        return ast.While(meta.line, items[0], items[1])

    def repeat_statement(self, meta: Meta, items: list[Any]) -> ast.Repeat:
        return ast.Repeat(meta.line, items[0], items[1])

    def jump(self, meta: Meta, items: list[Any]) -> ast.Jump:
        return ast.Jump(meta.line, str(items[0]).upper())


@v_args(meta=True)
class Tree(_Statements):  # pyright: ignore[reportGeneralTypeIssues] - as above
    """All rules: expressions, statements, declarations."""

    def qualified(self, meta: Meta, items: list[Any]) -> ast.NamedType:
        return ast.NamedType(meta.line, ".".join(items))

    def named_type(self, meta: Meta, items: list[Any]) -> ast.NamedType:
        return items[0]

    def sized_type(self, meta: Meta, items: list[Any]) -> ast.NamedType:
        return ast.NamedType(meta.line, items[0].name, sized=True)

    def range(self, meta: Meta, items: list[Any]) -> tuple[Any, Any]:
        return items[0], items[1]

    def array_type(self, meta: Meta, items: list[Any]) -> ast.ArrayType:
        return ast.ArrayType(meta.line, tuple(items[:-1]), items[-1])

    def pointer_type(self, meta: Meta, items: list[Any]) -> ast.PointerType:
        return ast.PointerType(meta.line, items[1], str(items[0]).upper())

    def array_item(self, meta: Meta, items: list[Any]) -> tuple[int, Any]:
        return 1, items[0]

    def repeated_item(self, meta: Meta, items: list[Any]) -> tuple[int, Any]:
        return int(_number(items[0])), items[1]

    def array_initial(self, meta: Meta, items: list[Any]) -> ast.ArrayInitial:
        return ast.ArrayInitial(meta.line, tuple(items))

    def struct_item(self, meta: Meta, items: list[Any]) -> tuple[str, Any]:
        return str(items[0]), items[1]

    def struct_initial(self, meta: Meta, items: list[Any]) -> ast.StructInitial:
        return ast.StructInitial(meta.line, tuple(items))

    def declaration(self, meta: Meta, items: list[Any]) -> list[ast.Declaration]:
        names = _of(items, "NAME")
        rest = [item for item in items if not isinstance(item, Token)]
        initial = rest[1] if len(rest) > 1 else None
        return [ast.Declaration(name.line or 0, str(name), rest[0], initial) for name in names]

    def block(self, meta: Meta, items: list[Any]) -> ast.Block:
        constant = any(str(word).upper() == "CONSTANT" for word in _of(items, "VAR_MODIFIER"))
        declared = tuple(one for item in items if isinstance(item, list) for one in item)
        return ast.Block(meta.line, str(items[0]).upper(), constant, declared)

    def result(self, meta: Meta, items: list[Any]) -> _Result:
        return _Result(items[0])

    def extension(self, meta: Meta, items: list[Any]) -> object:
        return _INHERITS

    def method(self, meta: Meta, items: list[Any]) -> ast.Method:
        name, results, bodies = _of(items, "NAME")[0], _nodes(items, _Result), _nodes(items, _Body)
        result = results[0].type if results else None
        return ast.Method(meta.line, str(name), result, _nodes(items, ast.Block), bodies[0] if bodies else ())

    method_head = method

    def pou(self, meta: Meta, items: list[Any]) -> ast.Pou:
        name, results, bodies = _of(items, "NAME")[0], _nodes(items, _Result), _nodes(items, _Body)
        return ast.Pou(
            meta.line,
            str(items[0]).upper(),
            str(name),
            _INHERITS in items,
            results[0].type if results else None,
            _nodes(items, ast.Block),
            bodies[0] if bodies else (),
            _nodes(items, ast.Method),
        )

    pou_head = pou

    def enum_item(self, meta: Meta, items: list[Any]) -> tuple[str, Any]:
        return str(items[0]), items[1] if len(items) > 1 else None

    def record(self, meta: Meta, items: list[Any]) -> tuple[str, Any]:
        return str(items[0]).upper(), tuple(one for item in items if isinstance(item, list) for one in item)

    def enumeration(self, meta: Meta, items: list[Any]) -> tuple[str, Any]:
        bases = _of(items, "NAME")
        defaults = _nodes(items, ast.NamedType)
        default = defaults[0].name.split(".")[-1] if defaults else ""
        return "ENUM", (_nodes(items, tuple), str(bases[0]) if bases else "INT", default)

    def alias(self, meta: Meta, items: list[Any]) -> tuple[str, Any]:
        return "ALIAS", items[0]

    def type_declaration(self, meta: Meta, items: list[Any]) -> ast.Record | ast.Enumeration | ast.Alias:
        name, (kind, body) = str(items[0]), items[1]
        if kind == "ENUM":
            return ast.Enumeration(meta.line, name, body[1], body[0], body[2])
        if kind == "ALIAS":
            return ast.Alias(meta.line, name, body)
        return ast.Record(meta.line, kind, name, body)

    def file(self, meta: Meta, items: list[Any]) -> tuple[Any, ...]:
        return tuple(items)

    def globals_file(self, meta: Meta, items: list[Any]) -> tuple[Any, ...]:
        return (ast.Globals("", tuple(items)),)
