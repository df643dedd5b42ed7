"""Source files: TwinCAT's XML (TcPOU, TcDUT, TcGVL) and plain texts."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import PurePosixPath

import st_ast as ast
from st_errors import StSyntaxError
from st_grammar import attributes, parse


def read_text(name: str, text: str) -> ast.Unit:
    """A plain source: POUs and types, or global variables named after the file."""
    items = parse(text, "file", name)
    stem = PurePosixPath(name.replace("\\", "/")).stem
    named = tuple(replace(item, name=stem) if isinstance(item, ast.Globals) else item for item in items)
    return ast.Unit(name, False, named, attributes(text))


def read_export(name: str, text: str) -> ast.Unit:
    """An exported file; declaration and implementation keep their own line numbers."""
    root = ET.fromstring(text)
    if len(root) == 0:
        raise StSyntaxError(f"{name}: empty")
    element = root[0]
    declaration = element.findtext("Declaration") or ""
    if element.tag == "DUT":
        return ast.Unit(name, True, parse(declaration, "file", name), attributes(declaration))
    if element.tag == "GVL":
        items = parse(declaration, "file", name)
        found = items[0] if items else None
        blocks = found.blocks if isinstance(found, ast.Globals) else ()
        return ast.Unit(name, True, (ast.Globals(element.get("Name", ""), blocks),), attributes(declaration))
    return ast.Unit(name, True, (_pou(name, element, declaration),), attributes(declaration))


def _pou(name: str, element: ET.Element, declaration: str) -> ast.Pou:
    head: ast.Pou = parse(declaration, "pou_head", f"{name} declaration")
    if head.name != element.get("Name"):
        raise StSyntaxError(f"{name}: declares {head.name}, the file says {element.get('Name')}")
    methods = tuple(_method(name, child) for child in element.findall("Method"))
    return replace(head, body=_body(name, element), methods=methods)


def _method(name: str, element: ET.Element) -> ast.Method:
    where = f"{name}, method {element.get('Name')}"
    head: ast.Method = parse(element.findtext("Declaration") or "", "method_head", f"{where} declaration")
    if head.name != element.get("Name"):
        raise StSyntaxError(f"{where}: declares {head.name}")
    return replace(head, body=_body(where, element))


def _body(where: str, element: ET.Element) -> tuple[ast.Statement, ...]:
    text = element.findtext("Implementation/ST") or ""
    return parse(text, "statements", f"{where} implementation")
