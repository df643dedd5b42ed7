"""A hand-written .st source taken apart: declaration, body and methods, as TwinCAT keeps them."""

import re
from dataclasses import dataclass

from protocol.errors import LocalProtocolError

_KINDS = ("FUNCTION_BLOCK", "FUNCTION", "PROGRAM")
_METHOD = re.compile(r"^METHOD\s+(?:PUBLIC\s+|PRIVATE\s+|INTERNAL\s+)?(\w+)", re.MULTILINE)
_HEAD = re.compile(r"^(FUNCTION_BLOCK|FUNCTION|PROGRAM)\s+(\w+)", re.MULTILINE)
_BLANK = re.compile(r"\(\*.*?\*\)|//[^\n]*", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Method:
    """One method of a function block."""

    name: str
    declaration: str
    body: str


@dataclass(frozen=True, slots=True)
class Pou:
    """One program organisation unit."""

    kind: str
    name: str
    declaration: str
    body: str
    methods: tuple[Method, ...]


def parse_pou(text: str) -> Pou:
    """Take one source file apart. Raises: LocalProtocolError: not one POU with its END, or a method without its own."""
    head = _HEAD.search(_without_comments(text))
    if head is None:
        raise LocalProtocolError(f"ST source: none of {', '.join(_KINDS)} found; one POU a file")
    kind, name = head.groups()
    end = text.rfind(f"END_{kind}")
    if end < 0:
        raise LocalProtocolError(f"ST source {name}: END_{kind} is missing")
    own, methods = _split_methods(text[:end], name)
    declaration, body = _split_declaration(own)
    return Pou(kind, name, declaration, body, methods)


def _without_comments(text: str) -> str:
    """The text with comments blanked out, every offset unchanged."""
    return _BLANK.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), text)


def _split_methods(text: str, owner: str) -> tuple[str, tuple[Method, ...]]:
    """The owner's own part, and its methods; comments between two methods belong to the second."""
    plain = _without_comments(text)
    starts = list(_METHOD.finditer(plain))
    if not starts:
        return text, ()
    own_end = begin = _comment_above(text, plain, starts[0].start())
    methods = []
    for i, start in enumerate(starts):
        end = plain.find("END_METHOD", start.end())
        following = starts[i + 1].start() if i + 1 < len(starts) else len(text)
        if not 0 <= end < following:
            raise LocalProtocolError(f"ST source {owner}: METHOD {start.group(1)} has no END_METHOD")
        declaration, body = _split_declaration(text[begin:end])
        methods.append(Method(start.group(1), declaration, body))
        begin = end + len("END_METHOD")
        if plain[begin:following].strip():
            raise LocalProtocolError(f"ST source {owner}: statements after METHOD {start.group(1)}; put them above")
    return text[:own_end], tuple(methods)


def _comment_above(text: str, plain: str, at: int) -> int:
    """Where the comment that ends on the line before `at` begins; `at` itself if there is none."""
    before = text[:at].rstrip()
    if not before.endswith("*)") or text[len(before) : at].count("\n") > 1:
        return at
    begin = before.rfind("(*")
    return begin if begin >= 0 and not plain[begin : len(before)].strip() else at


def _split_declaration(text: str) -> tuple[str, str]:
    """Everything up to the last END_VAR, and what follows."""
    plain = _without_comments(text)
    last = plain.rfind("END_VAR")
    if last >= 0:
        cut = last + len("END_VAR")
    else:
        head = re.search(r"^(?:FUNCTION_BLOCK|FUNCTION|PROGRAM|METHOD)[^\n]*\n?", plain, re.MULTILINE)
        cut = head.end() if head else 0
    return text[:cut].strip() + "\n", text[cut:].strip() + "\n"
