"""The answer in a few lines for a terminal."""

from typing import Any

NAMES_MAX = 5


def lines(result: dict[str, Any]) -> list[str]:
    """What a person reads after the budget."""
    out = [f"verdict: {result['verdict']} ({result['why']})"]
    for members in result["indistinguishable"]:
        out.append("this recording cannot distinguish: " + ", ".join(place_text(one) for one in members))
    closed = result["shrink"].get("overall", {}).get("closed_frac")
    if closed is not None:
        out.append(f"gap closed on held-out motions: {100 * closed:.3g} %")
    for one in result["unexplained"][:NAMES_MAX]:
        where = f"{one['stage']} {one['joint']}" if one["joint"] else one["stage"]
        out.append(f"unexplained in {where}: {one['lead'] or 'more than noise'} ({one['test']} {one['size']:.3g})")
    following = result["next_experiment"]
    if following["what"]:
        out.append(f"next experiment: {following['what']}, {following['minutes']:g} min: {following['why']}")
    out += [f"missing: {one['costs']}" for one in result["missing"]]
    return out


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
