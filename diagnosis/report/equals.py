"""Names that a recording cannot tell apart count as one for whoever reads the answer."""

from typing import Any

Key = tuple[str, int | None]


def equals_of(result: dict[str, Any], effect: dict[str, Any]) -> list[dict[str, Any]]:
    """What this recording cannot tell from an effect."""
    own = _key(effect)
    classes = [members for members in result["indistinguishable"] if own in {_key(one) for one in members}]
    return [one for members in classes for one in members if _key(one) != own]


def rows_alike(result: dict[str, Any], number: int = 0) -> list[int]:
    """Numbers of the hypotheses that only put equal names in the place of this one's, its own with them."""
    classes = [_classes(result, one["effects"]) for one in result["hypotheses"]]
    return [k for k, names in enumerate(classes) if names == classes[number]]


def probability_with_equals(result: dict[str, Any], number: int = 0) -> float:
    """Of a hypothesis, with all of those printed that are its equals."""
    return float(sum(result["hypotheses"][k]["probability"] for k in rows_alike(result, number)))


def _classes(result: dict[str, Any], effects: list[dict[str, Any]]) -> list[str]:
    return sorted(str(min(map(str, [_key(one), *map(_key, equals_of(result, one))]))) for one in effects)


def _key(one: dict[str, Any]) -> Key:
    return one["name"], one["joint"]
