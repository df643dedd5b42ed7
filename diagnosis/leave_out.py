"""What the answer would be if an effect that it names were not in the library: it should refuse, not rename."""

from typing import Any

from diagnosis.answer import judgement
from diagnosis.chain.unlike import nothing_sticks
from diagnosis.diagnose import Diagnosis, concluded
from diagnosis.search.score import STICKS
from diagnosis.search.search import searched_without


def leave_named_out(found: Diagnosis) -> list[dict[str, Any]]:
    """Verdict, names and first stage without each named effect in turn; everything fitted without it is reused."""
    named = dict.fromkeys(one.name for cell in found.cells for one in cell.chosen.fit.hypothesis)
    return [_told(name, without_effect(found, name), found) for name in named]


def without_effect(found: Diagnosis, name: str) -> Diagnosis:
    """The diagnosis with one effect less in its library; only cells that could name it are searched again."""
    searches = [
        searched_without(one.search, name) if _holds(one.search.cell.candidates, name) else one.search
        for one in found.cells
    ]
    if name == STICKS:
        searches = [nothing_sticks(one) for one in searches]
    return concluded(found.whole, searches, known=found.cells)


def _holds(candidates: tuple[Any, ...], name: str) -> bool:
    return any(one.name == name for one in candidates)


def _told(name: str, left: Diagnosis, found: Diagnosis) -> dict[str, Any]:
    result = judgement(left)
    best = result["hypotheses"][0]["effects"] if result["hypotheses"] else []
    return {
        "without": name,
        "verdict": result["verdict"],
        "why": result["why"],
        "named": best,
        "lost_nats": sum(one.chosen.total for one in found.cells) - sum(one.chosen.total for one in left.cells),
        "outside_probability": result["outside_probability"],
        "localisation": [one for one in result["localisation"] if one["regime"] == "all" or one["joint"] is None],
    }
