"""The chain of stages with the gap on each: seven boxes, the stage's share of the whole gap as a bar in each."""

from html import escape
from typing import Any

from diagnosis.report.html import wrap_scrollable
from machine.effects.spec import STAGES

BOX_W, BOX_H, STEP = 92, 112, 104
LEFT, TOP = 6, 6
BAR_HEIGHT_PX = 40
BOX_TEXT_LETTERS_MAX = 15  # letters of a cause across a box; longer ones are drawn narrower


def chain_svg(result: dict[str, Any]) -> str:
    """SVG of the chain with a line below it for what could not be judged apart."""
    shares = stage_shares(result)
    judged = {search["stage"] for search in result["searched"]} | set(shares)
    named = _confirmed_names_by_stage(result)
    largest = max(shares.values(), default=0.0)
    boxes = [
        _stage_box_svg(number, stage, shares.get(stage), stage in judged, named.get(stage, []), largest)
        for number, stage in enumerate(STAGES)
    ]
    width = LEFT * 2 + STEP * (len(STAGES) - 1) + BOX_W
    label = "chain of stages with the share of the gap on each"
    size = f'viewBox="0 0 {width} {BOX_H + 2 * TOP}"'
    svg = f'<svg class="chain" {size} role="img" aria-label="{label}">{"".join(boxes)}</svg>'
    merged = "".join(
        f"<li>{escape(' and '.join(merged_stage['stages']))} count as one: {escape(merged_stage['missing'])}</li>"
        for merged_stage in result["merged_stages"]
    )
    note = "<p>Bar: share of the gap, by what was found wrong there. A stage is judged by its own measured input.</p>"
    return wrap_scrollable(svg) + note + (f"<ul>{merged}</ul>" if merged else "")


def stage_shares(result: dict[str, Any]) -> dict[str, float]:
    """Share of the gap on each judged stage, by the rows of totals."""
    shares: dict[str, float] = {}
    for place in filter(is_total, result["localisation"]):  # one a unit, where some joints turn and others slide
        shares[place["stage"]] = shares.get(place["stage"], 0.0) + float(place["share_frac"] or 0.0)
    return shares


def is_total(place: dict[str, Any]) -> bool:
    """Whether a row of the localisation is of a stage as a whole, or of all of its joints that turn or slide."""
    return place["joint"] is None and place["axis"] is None


def _confirmed_names_by_stage(result: dict[str, Any]) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for effect in result["budget"]["effects"]:
        if effect["status"] == "confirmed":
            out.setdefault(effect["stage"], []).append(effect["name"].replace("_", " "))
            if effect["joint"] is not None:
                out[effect["stage"]].append(f"joint {effect['joint']}")
    return out


def _stage_box_svg(number: int, stage: str, share: float | None, judged: bool, named: list[str], largest: float) -> str:
    x, css = LEFT + STEP * number, "stage" if judged else "stage unjudged"
    css += " named" if named else ""
    out = [f'<rect class="{css}" x="{x}" y="{TOP}" width="{BOX_W}" height="{BOX_H}" rx="6"/>']
    if number:
        out.append(f'<path class="arrow" d="M{x - STEP + BOX_W} {TOP + BOX_H / 2}h{STEP - BOX_W - 4}l-4 -4m4 4l-4 4"/>')
    middle = x + BOX_W / 2
    out.append(f'<text class="title" x="{middle}" y="{TOP + 17}" text-anchor="middle">{stage}</text>')
    if share is None:
        text = "nothing there" if judged else "not measured"
        out.append(f'<text x="{middle}" y="{TOP + 55}" text-anchor="middle">{text}</text>')
    else:
        height = BAR_HEIGHT_PX * share / largest if largest > 0.0 else 0.0
        base = TOP + 24 + BAR_HEIGHT_PX
        out.append(
            f'<rect class="track" x="{middle - 12}" y="{base - BAR_HEIGHT_PX}" width="24" height="{BAR_HEIGHT_PX}"/>'
        )
        out.append(f'<rect class="bar" x="{middle - 12}" y="{base - height:.1f}" width="24" height="{height:.1f}"/>')
        out.append(f'<text x="{middle}" y="{base + 14}" text-anchor="middle">{100 * share:.0f} %</text>')
    for k, text in enumerate(_shorten_effect_list(named)):
        narrow = (
            f' textLength="{BOX_W - 8}" lengthAdjust="spacingAndGlyphs"' if len(text) > BOX_TEXT_LETTERS_MAX else ""
        )
        at = f'x="{middle}" y="{TOP + 90 + 11 * k}" text-anchor="middle"'
        out.append(f'<text class="cause" {at}{narrow}>{escape(text)}</text>')
    return f"<g>{''.join(out)}</g>"


def _shorten_effect_list(named: list[str]) -> list[str]:
    """At most two lines; more effects are counted, the list of hypotheses has them all."""
    return (
        named if len(named) <= 2 else [named[0], f"and {sum(not text.startswith('joint') for text in named) - 1} more"]
    )
