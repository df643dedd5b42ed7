"""Whether probabilities were as often right as they said: what was stated, in five bins, against the share right."""

from itertools import pairwise
from typing import Any

from benchmarks.diagnosis.gap.figures import Cases

Bin = tuple[str, int, float, float]  # what was stated, cases, mean stated, share right
BINS = 5


def by_width(cases: Cases) -> list[Bin]:
    """Probability of the best answer or its equals against the share right: bin, cases, mean stated, share right.

    Why with its equals: an answer that is the truth's equal counts as right, so that is what has to be as probable.
    """
    rows = [_binned([one for one in cases if _bin(stated(one)) == k], k / BINS, (k + 1) / BINS) for k in range(BINS)]
    return [row for row in rows if row is not None]


def by_fifths(cases: Cases) -> list[Bin]:
    """The same in five bins of as many cases: where probabilities crowd, bins of equal width hold few or none."""
    order = sorted(cases, key=stated)
    ends = [len(order) * k // BINS for k in range(BINS + 1)]
    fifths = [order[i:j] for i, j in pairwise(ends)]
    rows = [_binned(inside, stated(inside[0]), stated(inside[-1])) for inside in fifths if inside]
    return [row for row in rows if row is not None]


def _bin(probability: float) -> int:
    return min(int(probability * BINS), BINS - 1)


def _binned(inside: Cases, low: float, high: float) -> Bin | None:
    if not inside:
        return None
    right = [_right(one) for one in inside]
    mean = sum(stated(one) for one in inside) / len(inside)
    return f"{low:.2g} to {high:.2g}", len(inside), mean, sum(right) / len(right)


def stated(one: dict[str, Any]) -> float:
    """Probability of the first hypothesis and its equals, as the answer gave it."""
    alone, share = float(one["probability"]), share_of_first(one)
    return alone * share / one["ladder"][0][1] if share else alone


def share_of_first(one: dict[str, Any]) -> float:
    """Of the first hypothesis and its equals, among what the catalogue explains; 0 where there is none."""
    ladder = one["ladder"]
    return float(sum(ladder[k][1] for k in one.get("equals", [0]))) if ladder else 0.0


def _right(one: dict[str, Any]) -> bool:
    if one["mix"] in ("foreign", "lacking"):
        return False
    return not one["named"] if one["mix"] == "none" else bool(one["exact_named"])
