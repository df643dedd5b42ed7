"""One self-contained HTML page: every table and figure of the paper beside ours, with what does not match and why."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from benchmarks.reproduce.paper_tables import DEFECTS
from benchmarks.reproduce.report_tables import Check, TableView

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.6em; } h2 { font-size: 1.25em; margin-top: 2.2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: 0.8em 0; font-size: 0.88em; }
th, td { border: 1px solid #ccc; padding: 0.25em 0.6em; text-align: left; vertical-align: top; }
th { background: #f3f3f3; } tr.paper td { background: #fdf2e9; }
td.yes { color: #1e8449; font-weight: 600; } td.no { color: #c0392b; font-weight: 600; }
figure { margin: 1em 0; } img { max-width: 100%; border: 1px solid #eee; }
figcaption, p.note { color: #444; font-size: 0.92em; max-width: 60em; }
@media (prefers-color-scheme: dark) { body { background: #fff; } }
"""


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG with its caption."""

    path: Path
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page: words, tables, pictures, in that order."""

    title: str
    words: tuple[str, ...] = ()
    tables: tuple[TableView, ...] = ()
    pictures: tuple[Picture, ...] = ()


def page(title: str, lead: Sequence[str], checks: Sequence[Check], sections: Sequence[Section]) -> str:
    """The whole page."""
    parts = [f"<h1>{escape(title)}</h1>", *(f"<p>{escape(text)}</p>" for text in lead)]
    if checks:
        parts.append(_checks(checks))
    parts += [_section(section) for section in sections]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'


def _checks(checks: Sequence[Check]) -> str:
    rows = "".join(
        f"<tr><td>{escape(check.name)}</td><td>{check.value:.1f} {check.unit}</td>"
        f"<td>{check.low:g} to {check.high:g} {check.unit}</td><td>{check.n}</td>"
        f'<td class="{"yes" if check.met else "no"}">{"inside" if check.met else "outside"}</td></tr>'
        for check in checks
    )
    head = "<tr><th>figure (fast world, image-based)</th><th>ours</th><th>expected</th><th>N</th><th></th></tr>"
    return f"<h2>The figures at a glance</h2><table>{head}{rows}</table>"


def _section(section: Section) -> str:
    words = "".join(f"<p>{escape(text)}</p>" for text in section.words)
    tables = "".join(table_html(view, section.title) for view in section.tables)
    return f"<h2>{escape(section.title)}</h2>{words}{tables}{''.join(_picture(one) for one in section.pictures)}"


def table_html(view: TableView, under: str = "") -> str:
    """A table; rows of the paper are tinted. Its title is left out when the section says it already."""
    head = "".join(f"<th>{escape(text)}</th>" for text in view.headings)
    rows = ""
    for row in view.rows:
        kind = ' class="paper"' if row[0].startswith("the paper") else ""
        rows += f"<tr{kind}>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>"
    note = f'<p class="note">{escape(view.note)}</p>' if view.note else ""
    title = "" if view.title == under else f"<h3>{escape(view.title)}</h3>"
    return f"{title}<table><tr>{head}</tr>{rows}</table>{note}"


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    caption = f"<b>{escape(picture.title)}</b> {escape(picture.caption)}"
    image = f'<img alt="{escape(picture.title)}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def defects_view() -> TableView:
    """What cannot be as it is printed."""
    rows = tuple((defect.where, defect.what) for defect in DEFECTS)
    return TableView("Defects of the printed tables", ("where", "what"), rows)
