"""What both pages, one recording's and a fleet's, are made of: a document, sections, tables."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

# The page's style sheet: light and dark, nothing loaded from elsewhere.
PAGE_CSS = """
:root{--ink:#1d2429;--soft:#5c6a73;--paper:#fff;--line:#d4dbe0;--before:#c2571a;--after:#1668b8;
--measured:#1d2429;
--good:#1d7a46;--warn:#9a6700;--bad:#b3261e;--tint:#f3f6f8}
@media (prefers-color-scheme:dark){:root{--ink:#e6ebee;--soft:#9fb0ba;--paper:#14191d;--line:#36424a;
--before:#f0955a;
--after:#6cb2f5;--measured:#e6ebee;--good:#5fd08f;--warn:#e8b84a;--bad:#ff8a80;--tint:#1d252b}}
body{font:15px/1.5 system-ui,sans-serif;max-width:62em;margin:1.5em auto;padding:0 1em;color:var(--ink);
background:var(--paper)}
.name{color:var(--soft);margin:0 0 .4em}h1{font-size:1.35em;margin:0}h2{font-size:1.1em;margin:1.8em 0 .5em}
h3{font-size:1em;margin:1em 0 .2em}
header{display:flex;gap:1em;border:2px solid var(--warn);border-left-width:10px;border-radius:6px;
padding:.8em 1em;background:var(--tint)}
header>span{font-size:2.2em;line-height:1;font-weight:700;color:var(--warn)}
header ul{margin:.4em 0 0;padding-left:1.2em}
header.none{border-color:var(--good)}header.none>span{color:var(--good)}
header.effects{border-color:var(--after)}header.effects>span{color:var(--after)}
header.partly{border-color:var(--after)}header.partly>span{color:var(--after)}
header.outside{border-color:var(--bad)}header.outside>span{color:var(--bad)}
.look{color:var(--soft);margin:.5em 0}
li,p,summary{overflow-wrap:anywhere}
table{border-collapse:collapse;margin:.4em 0}
th,td{padding:.2em .7em;border-bottom:1px solid var(--line);text-align:left}
td.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
details{margin:.6em 0;border:1px solid var(--line);border-radius:6px;padding:.3em .8em}
summary{cursor:pointer;font-weight:600}
svg text{font:12px system-ui,sans-serif;fill:var(--soft)}
.wide{overflow-x:auto}
svg.plot,svg.chain{width:100%;min-width:38em;height:auto;display:block}
svg text.title{font-weight:600;fill:var(--ink)}
svg text.cause{font-size:9px;font-weight:700;fill:var(--after)}
.frame{fill:none;stroke:var(--line)}.grid{stroke:var(--line);stroke-dasharray:2 4}
.track{fill:var(--line);opacity:.5}
path{fill:none;stroke-width:1.4}.before{stroke:var(--before)}.after{stroke:var(--after)}.dots{stroke-width:3.5;stroke-linecap:round}
.measured{stroke:var(--measured);stroke-width:2.4;opacity:.55}.floor{stroke:var(--soft);stroke-dasharray:5 4}
.bar{fill:var(--after)}.faint{opacity:.4}.stage{fill:var(--tint);stroke:var(--line)}
.unjudged{stroke-dasharray:5 4;fill:none}
.stage.named{stroke:var(--after);stroke-width:2.5}.arrow{stroke:var(--soft)}
.legend span{margin-right:1.4em;color:var(--soft)}.legend{margin:.1em 0 .9em 4em}
@media (max-width:40em){.legend{margin-left:0}}
svg.inline{vertical-align:middle}
.fall.before{fill:var(--before);stroke:none}.fall.step{fill:var(--after)}.fall.left{fill:var(--soft)}
@media print{details{border:none}}
"""


def html_document(title: str, body: str) -> str:
    """The whole page, without scripts."""
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{PAGE_CSS}</style>"
    )
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def html_section(title: str, body: str) -> str:
    """A section with its heading; nothing where there is nothing to show."""
    return f"<section><h2>{escape(title)}</h2>{body}</section>" if body else ""


def html_table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table; nothing without rows. Numbers to four digits, None as an empty cell."""
    lines = "".join("<tr>" + "".join(_table_cell(value) for value in row) + "</tr>" for row in rows)
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    return wrap_scrollable(f"<table><tr>{head}</tr>{lines}</table>") if lines else ""


def wrap_scrollable(body: str) -> str:
    """What may be wider than a small screen: it is moved on its own, not the page."""
    return f'<div class="wide">{body}</div>'


def _table_cell(value: Any) -> str:
    if isinstance(value, float):
        return f'<td class="n">{value:.4g}</td>'
    return f"<td>{'' if value is None else escape(str(value))}</td>"
