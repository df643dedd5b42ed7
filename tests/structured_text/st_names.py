"""What a piece of the syntax tree names, changes and calls."""

from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import st_ast as ast


def nodes(tree: Any) -> Iterator[Any]:
    """Every node below and including this one."""
    if isinstance(tree, tuple):
        for item in tree:
            yield from nodes(item)
    elif is_dataclass(tree):
        yield tree
        for field in fields(tree):
            yield from nodes(getattr(tree, field.name))


def root(expression: Any) -> str:
    """The first name of a.b[i]^, lower case; THIS^.a gives a; empty where there is none."""
    while isinstance(expression, ast.Member | ast.Index | ast.Deref):
        base = expression.base
        if isinstance(expression, ast.Member) and isinstance(base, ast.Deref) and isinstance(base.base, ast.Name):
            return expression.name.lower()
        expression = base
    return expression.text.lower() if isinstance(expression, ast.Name) else ""


def changed(statements: Iterable[ast.Statement]) -> set[str]:
    """Names that the statements may write: targets, loop variables, whatever is handed to a call."""
    found: set[str] = set()
    for node in nodes(tuple(statements)):
        if isinstance(node, ast.Assign):
            found.add(root(node.target))
        elif isinstance(node, ast.For):
            found.add(node.variable.lower())
        elif isinstance(node, ast.Argument):
            found.add(root(node.value))
        elif isinstance(node, ast.Call):
            found.add(root(node.target))
    return found


def named(tree: Any) -> set[str]:
    """Names at the root of every variable in an expression or body."""
    return {node.text.lower() for node in nodes(tree) if isinstance(node, ast.Name)}


def calls(tree: Any) -> list[ast.Call]:
    """Every call."""
    return [node for node in nodes(tree) if isinstance(node, ast.Call)]
