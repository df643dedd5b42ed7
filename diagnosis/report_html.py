"""The answer as one page without scripts: summary and tables."""

from html import escape
from typing import Any

from diagnosis.report_text import effects_text, place_text

STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222;background:#fff}"
    "table{border-collapse:collapse;margin:1em 0}th,td{padding:.25em .7em;border-bottom:1px solid #ccc;text-align:left}"
    "td.n{text-align:right;font-variant-numeric:tabular-nums}h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}"
)
PLACES_MAX = 40


def page(result: dict[str, Any], name: str) -> str:
    """The whole page."""
    body = [
        f"<h1>Sim-to-real gap of {escape(name)}: {escape(result['verdict'])}</h1><p>{escape(result['why'])}</p>",
        _hypotheses(result),
        _classes(result),
        _table(
            "Where the gap lies",
            _places(result),
            ("stage", "joint", "axis", "regime", "gap", "floor", "unit", "share_frac"),
        ),
        _table(
            "How far it shrinks on held-out trajectories",
            _shrinks(result),
            ("stage", "joint", "unit", "before", "after", "floor", "closed_frac", "low", "high"),
        ),
        _table("Unexplained", result["unexplained"], ("stage", "joint", "test", "size", "p_value", "lead")),
        _table(
            "Smallest effects this recording could show",
            result["detection_limits"],
            ("name", "joint", "parameter", "size", "unit"),
        ),
        _next(result),
        _table("What was missing", result["missing"], ("signal", "costs")),
        _table("Findings about the recording", result["findings"], ("severity", "text")),
    ]
    head = f'<meta charset="utf-8"><title>{escape(name)}</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(body)}</body></html>\n'


def _hypotheses(result: dict[str, Any]) -> str:
    rows = [
        {"probability": one["probability"], "hypothesis": effects_text(one["effects"])} for one in result["hypotheses"]
    ]
    return _table("Hypotheses", rows, ("probability", "hypothesis"))


def _classes(result: dict[str, Any]) -> str:
    rows = [{"effects": ", ".join(place_text(one) for one in members)} for members in result["indistinguishable"]]
    return _table("Effects that this recording cannot tell apart", rows, ("effects",))


def _places(result: dict[str, Any]) -> list[dict[str, Any]]:
    return [one for one in result["localisation"] if one["regime"] == "all" or one["joint"] is None][:PLACES_MAX]


def _shrinks(result: dict[str, Any]) -> list[dict[str, Any]]:
    overall = result["shrink"].get("overall") or {}
    return [{"stage": "all", "joint": None, **overall}, *result["shrink"].get("stages", [])]


def _next(result: dict[str, Any]) -> str:
    one = result["next_experiment"]
    if not one["what"]:
        return f"<h2>Next experiment</h2><p>{escape(one['why'])}</p>"
    pair = " from ".join(place_text(member) for member in one["separates"])
    nats = f", about {one['expected_nats']:.3g} nats" if one["expected_nats"] is not None else ""
    text = f"{one['what']} for {one['minutes']:g} min: tells {pair}{nats}. {one['why']}."
    return f"<h2>Next experiment</h2><p>{escape(text)}</p>"


def _table(title: str, rows: list[dict[str, Any]], columns: tuple[str, ...]) -> str:
    if not rows:
        return ""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    lines = "".join("<tr>" + "".join(_cell(row.get(column)) for column in columns) + "</tr>" for row in rows)
    return f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{lines}</table>"


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f'<td class="n">{value:.4g}</td>'
    return f"<td>{'' if value is None else escape(str(value))}</td>"
