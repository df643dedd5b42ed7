"""The error budget for a person: one sentence in millimetres, a waterfall of the effects, tables."""

from html import escape
from math import sqrt
from typing import Any

from diagnosis.report.html import html_section, html_table, wrap_scrollable
from diagnosis.report.text import place_text
from diagnosis.verdict import SMALL_MM

VERDICT_SYMBOLS = {"none": "✓", "effects": "✓", "partly": "◐", "outside": "✗", "undecided": "?"}
BUDGET_COLUMN_LABELS = {
    "stands": "where the tool stands",
    "gets_there": "how it gets there",
    "sees": "what the camera sees",
}
STAGE_VERDICT_LABELS = {
    "none": "no gap",
    "explained": "explained",
    "partly": "partly explained",
    "unexplained": "not explained",
    "not_measured": "not measured",
}
ROW, LABEL, WIDTH, RIGHT = 24, 300, 720, 60
DRAWN_EFFECTS_MAX = 12  # effects drawn; the table has them all
DRAWN_STEP_MIN_MM = 0.05  # a step that is narrower than a line is not drawn
NAMED_ALTERNATIVES_MAX = 3  # sets in an effect's place that a line names; the JSON has them all


def budget_lines(result: dict[str, Any]) -> list[str]:
    """The budget for a terminal."""
    out = [result["budget"]["sentence"]]
    effects = result["budget"]["effects"]
    small = [effect for effect in effects if _is_small(effect)]
    for effect in (effect for effect in effects if not _is_small(effect)):
        size = f"{effect['tool_mm']:7.2f} mm [{effect['tool_low_mm']:.2f}, {effect['tool_high_mm']:.2f}]"
        out.append(
            f"  {place_text(effect):34} {size:28} p {effect['probability']:.2f}  {effect['status']}"
            + _alternatives_text(effect)
        )
    if small:
        sure = sum(effect["status"] == "confirmed" for effect in small)
        out.append(
            f"  {len(small)} further effects below {SMALL_MM:g} mm each, {sure} of them confirmed (see the report)"
        )
    for row in result["budget"]["unexplained_mm"]:
        where = f"{row['stage']} {row['joint']}" if row["joint"] else row["stage"]
        out.append(f"  {'unexplained, ' + where:34} {row['mm'] or 0.0:7.2f} mm")
    return out


def _is_small(effect: dict[str, Any]) -> bool:
    """Whether it is known to do little at the tool."""
    return bool(effect["column"]) and effect["tool_mm"] < SMALL_MM


def _alternatives_text(effect: dict[str, Any]) -> str:
    others = [" + ".join(place_text(member) for member in members) for members in effect["equals"]]
    more = [f"{len(others) - NAMED_ALTERNATIVES_MAX} more"] if len(others) > NAMED_ALTERNATIVES_MAX else []
    return f"  (or {', or '.join([*others[:NAMED_ALTERNATIVES_MAX], *more])})" if others else ""


def budget_head(result: dict[str, Any], name: str) -> str:
    """The first thing on the page."""
    drive = result["next_experiment"]
    facts = [result["why"]]
    first = next(iter(result["budget"]["effects"]), None)
    if first is not None:
        facts.append(
            f"largest cause: {place_text(first).replace('_', ' ')}, {first['tool_mm']:.3g} mm at the tool, "
            f"probability {100 * first['probability']:.0f} %, {first['status']}"
        )
    if drive.get("what"):
        facts.append(f"drive next: {drive['what']}, {drive['minutes']:g} min ({drive['why']})")
    items = "".join(f"<li>{escape(text)}</li>" for text in facts)
    return (
        f"<p class='name'>Error budget of {escape(name)}</p>"
        f'<header class="{escape(result["verdict"])}">'
        f'<span aria-hidden="true">{VERDICT_SYMBOLS[result["verdict"]]}</span>'
        f"<div><h1>{escape(result['budget']['sentence'])}</h1><ul>{items}</ul></div></header>"
    )


def budget_sections(result: dict[str, Any]) -> str:
    """Waterfalls, the three columns, every effect, every stage."""
    budget = result["budget"]
    tool = [column for column in budget["columns"] if column["column"] != "sees"]
    camera = [column for column in budget["columns"] if column["column"] == "sees"]
    return "".join(
        [
            html_section(
                "What costs how much at the tool", _waterfall_chart(budget["effects"], tool, ("stands", "gets_there"))
            ),
            html_section("What the camera misplaces", _waterfall_chart(budget["effects"], camera, ("sees",))),
            html_section("Where the error arises", _columns_table(budget["columns"])),
            html_section("Every effect", _effects_table(budget["effects"])),
            html_section("Every stage and joint", _stages_table(result["stages"])),
        ]
    )


def _waterfall_chart(effects: list[dict[str, Any]], columns: list[dict[str, Any]], names: tuple[str, ...]) -> str:
    """From the nominal model's miss down to what is left, an effect a step; steps are differences of RMS."""
    own = [
        effect
        for effect in effects
        if effect["column"] in names and effect["status"] == "confirmed" and effect["tool_mm"] > DRAWN_STEP_MIN_MM
    ]
    if not columns:
        return ""
    start = sqrt(sum(column["before_mm"] ** 2 for column in columns))
    end = sqrt(sum(column["after_mm"] ** 2 for column in columns))
    total = sum(effect["squares_mm2"] for effect in own) or 1.0
    scale = (start**2 - end**2) / total  # so that the steps end at what was measured to be left
    rows, level, square = [("nominal model misses", 0.0, start, "before")], start, start**2
    for effect in own[:DRAWN_EFFECTS_MAX]:
        square = max(0.0, square - scale * effect["squares_mm2"])
        rows.append((place_text(effect).replace("_", " "), sqrt(square), level, "step"))
        level = sqrt(square)
    if len(own) > DRAWN_EFFECTS_MAX:
        rows.append((f"{len(own) - DRAWN_EFFECTS_MAX} smaller effects", end, level, "step"))
    rows.append(("left with the confirmed effects", 0.0, end, "left"))
    most = max(high for _, _, high, _ in rows) or 1.0
    span = WIDTH - LABEL - RIGHT
    body = []
    for k, (label, low, high, css) in enumerate(rows):
        a, b = sorted((low, high))
        x, width, y = LABEL + span * a / most, max(1.0, span * (b - a) / most), 6 + ROW * k
        value = f"{b - a:.3g} mm" if css != "step" else f"{'-' if high >= low else '+'}{b - a:.2g} mm"
        body.append(
            f'<text x="{LABEL - 8}" y="{y + 14}" text-anchor="end">{escape(label)}</text>'
            f'<rect class="fall {css}" x="{x:.1f}" y="{y}" width="{width:.1f}" height="{ROW - 6}"/>'
            f'<text x="{x + width + 5:.1f}" y="{y + 14}">{value}</text>'
        )
    size = f'viewBox="0 0 {WIDTH} {12 + ROW * len(rows)}"'
    title = "waterfall from the nominal model's miss to what is left"
    return wrap_scrollable(f'<svg class="plot" {size} role="img" aria-label="{title}">{"".join(body)}</svg>')


def _columns_table(columns: list[dict[str, Any]]) -> str:
    rows = [
        [
            BUDGET_COLUMN_LABELS[column["column"]],
            column["before_mm"],
            column["after_mm"],
            column["floor_mm"],
            "measured" if column["measured"] else "by the model only",
        ]
        for column in columns
    ]
    return html_table(("", "nominal, mm", "with confirmed effects, mm", "noise, mm", ""), rows)


def _effects_table(effects: list[dict[str, Any]]) -> str:
    rows = [
        [
            place_text(effect).replace("_", " "),
            BUDGET_COLUMN_LABELS.get(effect["column"], ""),
            f"{effect['tool_mm']:.3g} ({effect['tool_low_mm']:.3g} to {effect['tool_high_mm']:.3g})",
            f"{100 * effect['share_frac']:.1f} %",
            f"{100 * effect['probability']:.0f} %",
            (effect["status"] + _alternatives_text(effect)).replace("_", " "),
        ]
        for effect in effects
    ]
    return html_table(("effect", "where", "mm at the tool (90 %)", "share of the square", "probability", ""), rows)


def _stages_table(stages: list[dict[str, Any]]) -> str:
    rows = [
        [
            stage["stage"] + (f" {stage['joint']}" if stage["joint"] else ""),
            STAGE_VERDICT_LABELS[stage["verdict"]],
            stage["before_mm"],
            stage["after_mm"],
            stage["would_measure"],
        ]
        for stage in stages
    ]
    return html_table(("stage", "verdict", "before, mm", "after, mm", "what would measure it"), rows)
