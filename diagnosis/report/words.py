"""What a person reads of effects and experiments."""

from html import escape
from typing import Any

from diagnosis.report.text import place_text
from machine.effects.registry import effect_named


def what_it_looks_like(result: dict[str, Any]) -> str:
    """For confirmed effects: what one would see on the machine, and what else could look so."""
    lines = []
    for one in result["budget"]["effects"]:
        if one["status"] != "confirmed":
            continue
        effect = effect_named(one["name"])
        if effect is not None:
            text = f"On the machine: {effect.looks_like}. Distinguished by: {effect.distinguished_by}."
            lines.append(f"<p class='look'><b>{escape(place_text(one).replace('_', ' '))}</b>: {escape(text)}</p>")
    return "".join(lines)


def next_text(result: dict[str, Any]) -> str:
    """What to drive next, and why."""
    one = result["next_experiment"]
    if not one["what"]:
        return str(one["why"])
    pair = " from ".join(place_text(member).replace("_", " ") for member in one["separates"])
    nats = f", about {one['expected_nats']:.3g} nats" if one["expected_nats"] is not None else ""
    return f"{one['what']} for {one['minutes']:g} min: tells {pair}{nats}. Why: {one['why']}."
