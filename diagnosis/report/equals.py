"""Names that a recording cannot tell apart count as one for whoever reads the answer."""

from typing import Any

Key = tuple[str, int | None]


def equals_of(result: dict[str, Any], effect: dict[str, Any]) -> list[dict[str, Any]]:
    """What this recording cannot tell from an effect."""
    own = _key(effect)
    classes = [members for members in result["indistinguishable"] if own in {_key(one) for one in members}]
    return [one for members in classes for one in members if _key(one) != own]


def _key(one: dict[str, Any]) -> Key:
    return one["name"], one["joint"]
