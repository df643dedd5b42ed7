"""Names that a recording cannot tell apart count as one for whoever reads the answer."""

from typing import Any

Key = tuple[str, int | None]


def equals_of(result: dict[str, Any], effect: dict[str, Any]) -> list[dict[str, Any]]:
    """What this recording cannot tell from an effect."""
    own = _key(effect)
    classes = [members for members in result["indistinguishable"] if own in {_key(one) for one in members}]
    return [one for members in classes for one in members if _key(one) != own]


def probability_with_equals(result: dict[str, Any]) -> float:
    """Of the first hypothesis, with all that only put an equal name in the place of one of its own."""
    first = _classes(result, result["hypotheses"][0]["effects"])
    alike = (one for one in result["hypotheses"] if _classes(result, one["effects"]) == first)
    return float(sum(one["probability"] for one in alike))


def _classes(result: dict[str, Any], effects: list[dict[str, Any]]) -> list[str]:
    return sorted(str(min(map(str, [_key(one), *map(_key, equals_of(result, one))]))) for one in effects)


def _key(one: dict[str, Any]) -> Key:
    return one["name"], one["joint"]
