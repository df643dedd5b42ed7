"""The answer in a few lines for a terminal."""

from typing import Any

from diagnosis.verdict.verdict import DOUBTED

SHAPES_MAX = 6
NAMES_MAX = 5


def lines(result: dict[str, Any]) -> list[str]:
    """What a person reads first."""
    out = [f"verdict: {result['verdict']} ({result['why']})"]
    if result["hypotheses"] and result["verdict"] in DOUBTED:
        out.append("what was weighed; the verdict says why none of it is an answer:")
    for hypothesis in result["hypotheses"][:NAMES_MAX]:
        out.append(_likely(hypothesis["probability"], effects_text(hypothesis["effects"])))
    if result["hypotheses"]:
        first = result["hypotheses"][0]
        if (together := first["probability_with_equals"]) > first["probability"]:
            out.append(_likely(together, "the first of these, or what this recording cannot tell from it"))
        out.append(_likely(result["unseen_probability"], "one more effect, below its detection limit here"))
        out.append(_likely(result["outside_probability"], "a cause outside the catalogue"))
    for members in result["indistinguishable"]:
        out.append("this recording cannot tell apart: " + ", ".join(place_text(one) for one in members))
    closed = result["shrink"].get("overall", {}).get("closed_frac")
    named = any(one["effects"] for one in result["hypotheses"][:1])
    if closed is not None and (named or result["verdict"] not in DOUBTED):
        out.append(_closed(closed, result["verdict"]))
    for one in result["unexplained"][:NAMES_MAX]:
        where = f"{one['stage']} {one['joint']}" if one["joint"] else one["stage"]
        out.append(f"unexplained in {where}: {one['lead'] or 'more than noise'} ({one['test']} {one['size']:.3g})")
    shapes = [f"{one['stage']} {one['joint'] or one['measurement']}: {one['goes_with']}" for one in result["shapes"]]
    if shapes:
        out.append(f"the remainder goes with: {', '.join(shapes[:SHAPES_MAX])}")
    following = result["next_experiment"]
    if following["what"]:
        out.append(f"next experiment: {following['what']}, {following['minutes']:g} min: {following['why']}")
    out += [f"missing: {one['costs']}" for one in result["missing"]]
    return out


def _closed(closed: float, verdict: str) -> str:
    """What the names take away; where they are not believed, that this is no proof of them."""
    text = f"gap closed on held-out trajectories: {100 * closed:.3g} %"
    return text if verdict not in DOUBTED else f"{text} by names that are not believed: wrong ones can, too"


def _likely(probability: float, what: str) -> str:
    return f"  {100 * probability:5.1f} %  {what}"


def place_text(one: dict[str, Any]) -> str:
    """An effect and its joint."""
    return one["name"] + (f" on joint {one['joint']}" if one["joint"] is not None else "")


def effects_text(effects: list[dict[str, Any]]) -> str:
    """A hypothesis in words."""
    return " + ".join(f"{place_text(one)} ({_numbers(one['parameters'])})" for one in effects) or "no effect"


def _numbers(parameters: dict[str, Any]) -> str:
    return "; ".join(f"{name} = {_number(one)}" for name, one in parameters.items())


def _number(one: dict[str, Any]) -> str:
    if not isinstance(one["value"], int | float) or one["low"] is None:
        return str(one["value"])
    if one["low"] == one["high"] == one["value"]:
        return f"{one['value']:.4g}"
    unit = "" if one["unit"] == "1" else f" {one['unit']}"
    return f"{one['value']:.4g}{unit}, 90 % {one['low']:.4g} to {one['high']:.4g}"
