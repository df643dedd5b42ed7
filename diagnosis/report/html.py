"""What both pages, one recording's and a fleet's, are made of: a document, sections, tables."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from diagnosis.report.style import STYLE


def document(title: str, body: str) -> str:
    """The whole page, without scripts."""
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style>"
    )
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def section(title: str, body: str) -> str:
    """A section with its heading; nothing where there is nothing to show."""
    return f"<section><h2>{escape(title)}</h2>{body}</section>" if body else ""


def table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table; nothing without rows. Numbers to four digits, None as an empty cell."""
    lines = "".join("<tr>" + "".join(_cell(value) for value in row) + "</tr>" for row in rows)
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    return wide(f"<table><tr>{head}</tr>{lines}</table>") if lines else ""


def wide(body: str) -> str:
    """What may be wider than a small screen: it is moved on its own, not the page."""
    return f'<div class="wide">{body}</div>'


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f'<td class="n">{value:.4g}</td>'
    return f"<td>{'' if value is None else escape(str(value))}</td>"
