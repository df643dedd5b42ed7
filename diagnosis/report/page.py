"""The answer as one page without scripts: the verdict first, then the evidence for it, then the details."""

from collections.abc import Sequence
from html import escape
from typing import Any

from diagnosis.report.budget import budget_head, budget_sections
from diagnosis.report.chain import chain_svg
from diagnosis.report.curves import CellCurves
from diagnosis.report.html import html_document, html_section, html_table
from diagnosis.report.plots import cell_plots
from diagnosis.report.text import place_text
from machine.effects.registry import effect_named


# What a person reads of effects and experiments.
def confirmed_effects_html(result: dict[str, Any]) -> str:
    """For confirmed effects: what one would see on the machine, and what else could look so."""
    lines = []
    for row in result["budget"]["effects"]:
        if row["status"] != "confirmed":
            continue
        effect = effect_named(row["name"])
        if effect is not None:
            text = f"On the machine: {effect.looks_like}. Distinguished by: {effect.distinguished_by}."
            lines.append(f"<p class='look'><b>{escape(place_text(row).replace('_', ' '))}</b>: {escape(text)}</p>")
    return "".join(lines)


def next_text(result: dict[str, Any]) -> str:
    """What to drive next, and why."""
    experiment = result["next_experiment"]
    if not experiment["what"]:
        return str(experiment["why"])
    pair = " from ".join(place_text(member).replace("_", " ") for member in experiment["separates"])
    nats = f", about {experiment['expected_nats']:.3g} nats" if experiment["expected_nats"] is not None else ""
    return (
        f"{experiment['what']} for {experiment['minutes']:g} min: distinguishes {pair}{nats}. Why: {experiment['why']}."
    )


LISTED_PLACES_MAX = 40


def report_page(result: dict[str, Any], name: str, curves: Sequence[CellCurves] = ()) -> str:
    """The whole page. `result`: the answer's JSON; `curves`: what cannot be drawn from it."""
    body = [
        budget_head(result, name) + budget_sections(result),
        html_section("Where the gap lies", chain_svg(result)),
        html_section("Measured, nominal, nominal with the effects", cell_plots(curves)),
        html_section("What cannot be distinguished", _indistinguishable_list(result)),
        html_section("Next experiment", f"<p>{escape(next_text(result))}</p>"),
        html_section("How far the gap shrinks on held-out trajectories", _shrink_table(result)),
        html_section("What nothing explains", _table_by_columns(result["unexplained"], UNEXPLAINED_TABLE_COLUMNS)),
        html_section(
            "What the recording lacked",
            _table_by_columns(result["missing"], (("signal", "signal"), ("costs", "costs"))),
        ),
        html_section("Findings about the recording", _table_by_columns(result["findings"], FINDING_TABLE_COLUMNS)),
        _collapsible_section("What the confirmed effects look like", confirmed_effects_html(result)),
        _collapsible_section(
            "Every place: stage, joint, axis, regime",
            _table_by_columns(_stages_with_most_gap(result), PLACE_TABLE_COLUMNS),
        ),
        _collapsible_section(
            "Smallest effects this recording could have shown",
            _table_by_columns(result["detection_limits"], DETECTION_LIMIT_TABLE_COLUMNS),
        ),
    ]
    return html_document(f"{name}: {result['verdict']}", "".join(body))


UNEXPLAINED_TABLE_COLUMNS = (
    ("stage", "stage"),
    ("joint", "joint"),
    ("test", "test"),
    ("size", "size"),
    ("p_value", "p"),
    ("lead", "lead"),
)
FINDING_TABLE_COLUMNS = (("severity", ""), ("text", "finding"))
PLACE_TABLE_COLUMNS = (
    ("stage", "stage"),
    ("joint", "joint"),
    ("axis", "axis"),
    ("regime", "regime"),
    ("gap", "gap"),
    ("floor", "noise floor"),
    ("unit", "unit"),
    ("gap_tcp_mm", "gap at the tcp, mm"),
    ("share_frac", "share"),
)
DETECTION_LIMIT_TABLE_COLUMNS = (
    ("name", "effect"),
    ("joint", "joint"),
    ("parameter", "parameter"),
    ("size", "size"),
    ("unit", "unit"),
)
GAP_CLOSURE_TABLE_COLUMNS = (
    ("stage", "stage"),
    ("joint", "joint"),
    ("measurement", "seen by"),
    ("before", "before"),
    ("after", "after"),
    ("floor", "noise floor"),
    ("unit", "unit"),
    ("closed", "closed"),
    ("limits", "90 %"),
)


def _collapsible_section(title: str, body: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{body}</details>" if body else ""


def _indistinguishable_list(result: dict[str, Any]) -> str:
    lines = "".join(
        f"<li>{escape(' and '.join(place_text(member) for member in members))}: "
        "the recording looks the same with either</li>"
        for members in result["indistinguishable"]
    )
    return f"<p>Cannot be distinguished here:</p><ul>{lines}</ul>" if lines else ""


def _stages_with_most_gap(result: dict[str, Any]) -> list[dict[str, Any]]:
    return [place for place in result["localisation"] if place["regime"] == "all" or place["joint"] is None][
        :LISTED_PLACES_MAX
    ]


def _shrink_table(result: dict[str, Any]) -> str:
    overall = result["shrink"].get("overall") or {}
    rows = [{"stage": "all", "joint": None, **overall}] if overall else []
    rows += result["shrink"].get("stages", [])
    return _table_by_columns(
        [{**row, "closed": _percent_text(row["closed_frac"]), "limits": _limits_text(row)} for row in rows],
        GAP_CLOSURE_TABLE_COLUMNS,
    )


def _percent_text(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def _limits_text(row: dict[str, Any]) -> str:
    if row["low"] is None or row["high"] is None:
        return ""
    return f"{_percent_text(row['low'])} to {_percent_text(row['high'])}"


def _table_by_columns(rows: list[dict[str, Any]], columns: tuple[tuple[str, str], ...]) -> str:
    return html_table([title for _, title in columns], [[row.get(key) for key, _ in columns] for row in rows])
