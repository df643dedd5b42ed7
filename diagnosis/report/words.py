"""The verdict in the words of somebody who has ten seconds."""

from dataclasses import dataclass
from html import escape
from typing import Any

from diagnosis.report.text import effects_text, place_text
from diagnosis.verdict.equals import equals_of
from machine.effects.registry import effect_named

MOST = 0.8  # of the gap: below it the names are a part of the cause
SIGNS = {"none": "✓", "effects": "!", "outside": "✗", "undecided": "?"}


@dataclass(frozen=True, slots=True)
class VerdictWords:
    """A sign, one line, and the few numbers that carry it."""

    sign: str
    headline: str
    facts: tuple[str, ...]


def verdict_text(result: dict[str, Any]) -> VerdictWords:
    """For each of the four verdicts."""
    word = result["verdict"]
    return VerdictWords(SIGNS[word], _headline(result), tuple(_facts(result)))


def _headline(result: dict[str, Any]) -> str:
    word = result["verdict"]
    if word == "none":
        return "No gap above the noise: the model fits this machine as far as this recording can tell"
    if word == "effects":
        names = [place_text(one).replace("_", " ") for one in result["hypotheses"][0]["effects"]]
        closed = (result["shrink"].get("overall") or {}).get("closed_frac")
        part = "Cause" if closed is None or closed >= MOST else f"Cause of {100 * closed:.0f} % of the gap"
        return f"{part} found: {' and '.join(names)}"
    if word == "outside":
        return "There is a gap, and no known effect explains it: do not trust any name below"
    return "Undecided: there may be a gap, but its cause cannot be named from this recording"


def _facts(result: dict[str, Any]) -> list[str]:
    word, facts = result["verdict"], []
    if word == "effects":
        best = result["hypotheses"][0]
        facts.append(effects_text(best["effects"]))
        facts.append(_probability(result))
        facts += [_equals(result, one) for one in best["effects"] if equals_of(result, one)]
    else:
        facts.append(result["why"])
    overall = result["shrink"].get("overall") or {}
    if word == "effects" and overall.get("closed_frac") is not None:
        low, high = overall.get("low"), overall.get("high")
        limits = "" if low is None or high is None else f" (90 %: {100 * low:.1f} to {100 * high:.1f} %)"
        facts.append(
            f"with it the model's gap on held-out trajectories shrinks by {100 * overall['closed_frac']:.1f} %{limits}"
        )
    if word == "effects" and ";" in result["why"]:  # what the names leave
        facts.append(result["why"].split("; ", 1)[1])
    return facts


def _probability(result: dict[str, Any]) -> str:
    first = result["hypotheses"][0]
    alone, together = first["probability"], first["probability_with_equals"]
    equal = " with its equals" if together > alone else ""
    return f"probability {100 * together:.0f} %{equal}"


def _equals(result: dict[str, Any], effect: dict[str, Any]) -> str:
    others = " or ".join(place_text(one) for one in equals_of(result, effect))
    return f"instead of {place_text(effect)} it may be {others}: this recording cannot tell"


def what_it_looks_like(result: dict[str, Any]) -> str:
    """For named effects: what one would see on the machine, and what else could look so."""
    if result["verdict"] != "effects":
        return ""
    lines = []
    for one in result["hypotheses"][0]["effects"]:
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
